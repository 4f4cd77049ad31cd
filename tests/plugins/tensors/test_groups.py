"""Groups of worlds: who is in which, what each has, sums over them."""

from __future__ import annotations

import pytest
import torch

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_tensors.groups import Groups


def of(worlds: int, evaluating: bool = False) -> Context:
    return Context(
        0, torch.device("cpu"), worlds, control_dt=0.01, substeps=1, evaluating=evaluating
    )


def test_worlds_are_dealt_out_in_turn() -> None:
    groups = Groups(["a", "b", "c"], of(7), absent=["d"])
    assert groups.number.tolist() == [0, 1, 2, 0, 1, 2, 0]
    flags = groups.flags()
    assert set(flags) == set(groups.fields) == {"from_a", "from_b", "from_c", "from_d"}
    assert flags["from_b"].tolist() == [0, 1, 0, 0, 1, 0, 0]
    assert not flags["from_d"].any()
    assert groups.of_worlds([[1.0], [2.0], [3.0]])[:, 0].tolist() == [1, 2, 3, 1, 2, 3, 1]


def test_sums_are_of_each_group() -> None:
    values = torch.arange(7, dtype=torch.float64)
    found = Groups(["a", "b", "c"], of(7)).sums(torch.stack([values, 2 * values]))
    assert found.tolist() == [[9, 5, 7], [18, 10, 14]]


def test_a_training_needs_a_world_for_each_and_an_evaluation_does_not() -> None:
    with pytest.raises(ConfigError, match="2 groups are more than there are worlds"):
        Groups(["a", "b"], of(1))
    assert Groups(["a", "b"], of(1, evaluating=True)).number.tolist() == [0]
