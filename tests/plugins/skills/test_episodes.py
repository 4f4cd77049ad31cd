"""Policies that act out episodes: whose moments are seen, and which weights are taken."""

from __future__ import annotations

from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest
import torch

from understudy.errors import RunError
from understudy_skills.episodes import act_out
from understudy_skills.skill import Skill


class Two:
    """Two worlds of two control periods a decision; the first's episode ends with the second decision."""

    num_worlds, device, decision, control_dt = 2, torch.device("cpu"), 2, 0.25
    observations = None

    def __init__(self) -> None:
        self.step = 0
        self.on_period: Any = None

    def advance(self, action: object) -> object:
        self.on_period()
        self.on_period()
        self.step += 1
        return SimpleNamespace(ended=torch.tensor([self.step == 2, False]))


def test_every_period_and_decision_is_seen_with_the_worlds_that_count() -> None:
    environment: Any = Two()
    policy: Any = SimpleNamespace(distribution=lambda seen: SimpleNamespace(mode=lambda: None))
    periods: list[list[bool]] = []
    decisions: list[list[bool]] = []
    act_out(
        environment, policy, 2.0,
        see=lambda running: periods.append(running.tolist()),
        decided=lambda running, step: decisions.append(running.tolist()),
    )  # fmt: skip
    both, one = [True, True], [False, True]
    assert periods == [both, both, both, both, one, one, one, one]
    assert decisions == [both, both, one, one]


class Line(torch.nn.Linear):
    def actor_parameters(self) -> Iterator[torch.nn.Parameter]:
        return self.parameters()

    def schedule(self, samples: int) -> None:
        self.samples = samples


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ({"weight": torch.zeros(1, 2), "bias": torch.zeros(1), "more": torch.zeros(1)}, "more differs"),
        ({"weight": torch.zeros(1, 3), "bias": torch.zeros(1)}, "weight differs"),
        ({"weight": torch.zeros(1, 2)}, "bias differs"),
        ({"weight": torch.full((1, 2), torch.nan), "bias": torch.zeros(1)}, "weight is not finite"),
    ],
)  # fmt: skip
def test_weights_of_another_shape_are_not_taken(given: dict[str, torch.Tensor], says: str) -> None:
    nothing: Any = None
    policy: Any = Line(2, 1)
    with pytest.raises(RunError, match=says):
        Skill("walk", nothing, given, 7, {}).give(policy)
    right = {"weight": torch.zeros(1, 2), "bias": torch.zeros(1)}
    Skill("walk", nothing, right, 7, {}).give(policy)
    assert policy.samples == 7
    assert not policy.weight.any()
