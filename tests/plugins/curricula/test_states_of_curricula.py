"""What a curriculum takes of a checkpoint: numbers that one of its kind can have, and no others."""

from __future__ import annotations

import copy
import math
from typing import Any

import pytest
import torch

from understudy.task import Context
from understudy_curricula.curricula import Adaptive, Linear
from understudy_curricula.staggered import Staggered
from understudy_deepmimic.curricula import Adaptive as Longer
from understudy_deepmimic.curricula import Annealed
from understudy_jumping.curriculum import Accumulated


def context() -> Context:
    return Context(seed=0, device=torch.device("cpu"), num_worlds=4, control_dt=0.1, substeps=1)


MADE = {
    "linear": lambda: Linear(Linear.Options(samples=100), context()),
    "adaptive": lambda: Adaptive(Adaptive.Options(threshold=0.5), context()),
    "staggered": lambda: Staggered(Staggered.Options(seconds=1.0), context()),
    "longer": lambda: Longer(Longer.Options(), context()),
    "annealed": lambda: Annealed(Annealed.Options(samples=100), context()),
    "accumulated": lambda: Accumulated(Accumulated.Options(), context()),
}


@pytest.mark.parametrize(
    ("kind", "name", "value"),
    [
        ("linear", "samples", -1), ("linear", "difficulty", -5.0), ("linear", "difficulty", 1.5),
        ("linear", "difficulty", "0"), ("linear", "samples", True), ("linear", "samples", math.nan),
        ("adaptive", "difficulty", -1e9), ("adaptive", "ended", -3), ("adaptive", "older", [-1]),
        ("adaptive", "older", [[0]]), ("staggered", "first", [-4]),
        ("longer", "seconds", -1.0), ("longer", "seconds", 1e9), ("longer", "recent", [[-1.0, 0.0, 0.0]]),
        ("longer", "recent", [[2.0, 3.0, 0.0]]), ("longer", "stagnation", {"best": 0.0, "since": -9}),
        ("annealed", "samples", -100), ("accumulated", "difficulty", [-1.0]),
    ],
)  # fmt: skip
def test_what_cannot_be_is_refused(kind: str, name: str, value: Any) -> None:
    """A difficulty below 0, or a world counted from the end, was taken without a word."""
    curriculum: Any = MADE[kind]()
    state = copy.deepcopy(curriculum.state_dict())
    curriculum.load_state_dict(state)
    assert name in state
    with pytest.raises(ValueError, match=r"cannot be|is .*, and not between|are no worlds"):
        curriculum.load_state_dict({**state, name: value})
