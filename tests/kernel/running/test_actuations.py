"""When controls are computed, and what a decision of several control periods is."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import pytest
import torch
from counted_task import Line, Push, line, push, term
from torch import Tensor
from worlds import assert_same_state


class Counting(Push):
    """The control is how often it was asked for, kept per world as ``count``; ``begun`` is where the
    episode began."""

    reads = ("x",)
    keeps = {"count": (), "begun": (1,)}

    def __init__(self, every: Any) -> None:
        super().__init__()
        self.every = every
        self.asked = 0

    def begin(self, x: Tensor) -> Mapping[str, Tensor]:
        return {"count": torch.zeros(len(x)), "begun": x.clone()}

    def advance(self, action: Tensor, x: Tensor) -> Mapping[str, Tensor]:
        self.asked += 1
        return {"count": self.environment.table["count"] + action[:, 0], "begun": self.begun()}

    def begun(self) -> Tensor:
        return self.environment.table["begun"]

    def control(self, action: Tensor, x: Tensor) -> Tensor:
        return self.environment.table["count"].unsqueeze(1)

    environment: Any = None


def counting(every: str, **more: Any) -> tuple[Any, Counting, Line]:
    actuation = Counting(every)
    environment = line(actuation=actuation, **more)
    actuation.environment = environment
    environment.reset()
    simulator = environment.parts.simulator
    assert isinstance(simulator, Line)
    simulator.calls.clear()
    return environment, actuation, simulator


@pytest.mark.parametrize(
    ("every", "asked", "calls", "moved"),
    [
        # the control is 1; then 1, 2; then 1 to 6; each physics step moves by it
        ("decision", 1, [None, None], 6 * 1),
        ("period", 2, [None, None], 3 * 1 + 3 * 2),
        ("substep", 6, [1] * 6, 1 + 2 + 3 + 4 + 5 + 6),
    ],
)
def test_how_often_controls_are_computed(
    every: str, asked: int, calls: list[int | None], moved: int
) -> None:
    """A decision of two control periods, of three physics steps each."""
    environment, actuation, simulator = counting(every, substeps=3, decision=2)
    push(environment, 1)
    assert actuation.asked == asked
    assert simulator.calls == calls
    assert environment.table["x"][:, 0].tolist() == [moved] * 4
    assert environment.table["count"].tolist() == [asked] * 4


def test_what_is_kept_begins_with_the_episode() -> None:
    environment, _, _ = counting("period", terminations=[term(lambda x: x[:, 0] >= 10, "far")])
    push(environment, 1, 2, 3, 10)
    assert environment.table["count"].tolist() == [1, 2, 3, 0]
    push(environment, 1, 2, 3, 4)
    assert environment.table["count"].tolist() == [2, 4, 6, 4]
    assert environment.table["x"][:, 0].tolist() == [3, 6, 9, 4]


def test_what_is_kept_is_resumed() -> None:
    one, _, _ = counting("period")
    two, _, _ = counting("period")
    push(one, 1, 2, 3, 4), push(two, 5)
    two.load_state_dict(one.state_dict())
    for _ in range(3):
        assert_same_state(vars(push(one, 1)), vars(push(two, 1)))
    assert_same_state(one.state_dict(), two.state_dict())


def test_a_decision_is_rewarded_once_and_takes_its_time() -> None:
    times = []

    def late(x: Tensor, episode_time: Tensor) -> Tensor:
        times.append(episode_time.tolist())
        return x[:, 0]

    environment = line(decision=3, seconds=6, control_dt=1.0, rewards=[term(late)])
    environment.reset()
    times.clear()
    first = push(environment, 1)
    assert (first.rewards.tolist(), first.truncated.tolist()) == ([3] * 4, [False] * 4)
    assert environment.episode_step.tolist() == [3] * 4
    second = push(environment, 1)
    assert (second.rewards.tolist(), second.truncated.tolist()) == ([6] * 4, [True] * 4)
    assert times == [[3] * 4, [6] * 4]
    assert second.returns.tolist() == [9] * 4


def test_the_action_is_a_field() -> None:
    environment = line(terminations=[term(lambda action: action[:, 0] >= 5, "hard")])
    environment.reset()
    push(environment, 1, 2, 5, 4)
    assert environment.table["action"][:, 0].tolist() == [1, 2, 0, 4], "zero after a beginning"
