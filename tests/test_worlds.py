"""What the tests compare states with can tell them apart."""

from __future__ import annotations

import pytest
import torch
from worlds import assert_same_state

NAN = float("nan")


@pytest.mark.parametrize(
    ("first", "second"),
    [
        (torch.tensor([NAN]), torch.tensor([0.0])),
        (torch.tensor([float("inf")]), torch.tensor([torch.finfo(torch.float32).max])),
        (torch.tensor([1.0]), torch.tensor([1.0], dtype=torch.float64)),
        (torch.tensor([1.0]), torch.tensor([[1.0]])),
        (1, 2),
        ([1], [1, 2]),
        ({"a": 1}, {"b": 1}),
    ],
)
def test_different(first: object, second: object) -> None:
    with pytest.raises(AssertionError):
        assert_same_state({"x": first}, {"x": second})


def test_the_same() -> None:
    state = {"x": torch.tensor([NAN, float("inf"), 0.0]), "n": [1, {"a": None}]}
    assert_same_state(state, {"n": [1, {"a": None}], "x": state["x"].clone()})
