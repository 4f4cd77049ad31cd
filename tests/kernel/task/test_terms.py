"""Terms: which fields a function reads, and under which names."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task.terms import make_term, parameters_of, renamed


def speed(qvel: Tensor, mass: Tensor | None = None, *, scale: float = 1.0) -> Tensor:
    return scale * qvel[:, 0]


class Sized:
    """Terms may be objects."""

    def __call__(self, qpos: Tensor) -> Tensor:
        return qpos[:, 0]


def test_parameters() -> None:
    assert parameters_of(speed) == {"qvel": False, "mass": True}
    assert parameters_of(Sized()) == {"qpos": False}


def test_renamed() -> None:
    assert renamed("here", "reads", ("a", "b"), {"b": "c"}) == {"a": "a", "b": "c"}
    with pytest.raises(
        ConfigError, match=r"^here\.reads: there is no field 'c' to rename\. Known: a, b\.$"
    ):
        renamed("here", "reads", ("a", "b"), {"c": "b"})


def test_make_term() -> None:
    term = make_term(
        "here", "fast", speed, {"scale": 2.0}, reads={"qvel": "other_qvel"}, weight=3.0
    )
    assert term.reads == {"qvel": "other_qvel", "mass": "mass"}
    assert term.optional == {"mass"}
    assert (term.name, term.weight, term.outcome, term.reduce) == ("fast", 3.0, "failure", "last")
    assert term.function(torch.ones(2, 1), **term.options).tolist() == [2.0, 2.0]
