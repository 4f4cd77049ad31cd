"""The curriculum that takes the help away."""

from __future__ import annotations

import pytest
import torch

from understudy.random import WorldStreams
from understudy.task import Context, Rollout
from understudy_morphology.lessons import Lessons

DT = 0.0165


def lessons(target: float = 1.0, evaluating: bool = False, **options: float) -> Lessons:
    context = Context(
        0, torch.device("cpu"), 4, DT, 4, difficulty=target, evaluating=evaluating
    )  # fmt: skip
    return Lessons(Lessons.Options(**{"episodes": 4, **options}), context)  # type: ignore[arg-type]


def rollout(reward: float, seconds: float = 8.25, speed: float = 1.0, ends: int = 4) -> Rollout:
    """One step of four worlds, in which `ends` episodes end."""
    row, none = torch.ones(1, 4), torch.zeros(1, 4, dtype=torch.bool)
    truncated = none.clone()
    truncated[:, :ends] = True
    fields = {
        "episode_time": (seconds - DT) * row,
        "forward_velocity": speed * row,
        "target_velocity": row,
    }
    return Rollout({}, {}, row, row, row, none, truncated, none, row, reward * row, fields)


def difficulty(curriculum: Lessons) -> float:
    found = curriculum.begin(WorldStreams(0, "test", 4, "cpu"))["difficulty"]
    assert found.shape == (4,)
    assert (found == found[0]).all()
    return float(found[0])


def test_help_goes_down_by_a_quarter_each_time_it_is_learned() -> None:
    curriculum = lessons()
    assert difficulty(curriculum) == 0.0
    curriculum.update(rollout(1000.0))
    assert difficulty(curriculum) == pytest.approx(0.25)
    curriculum.update(rollout(800.0))
    assert difficulty(curriculum) == pytest.approx(1 - 0.75**2)
    for _ in range(10):
        curriculum.update(rollout(800.0))
    assert difficulty(curriculum) == pytest.approx(1 - 0.75**12)
    found = curriculum.update(rollout(800.0))
    assert difficulty(curriculum) == 1.0  # less than 5 N/m is none
    assert found["mark/help 0%"] == 1.0
    assert curriculum.update(rollout(800.0)).keys().isdisjoint({"mark/help 0%"})


@pytest.mark.parametrize(
    "worse",
    [
        rollout(690.0),
        rollout(1000.0, seconds=5.9),
        rollout(1000.0, speed=0.4),
        rollout(1e3, ends=3),
    ],
)
def test_a_lesson_that_is_not_learned_goes_on(worse: Rollout) -> None:
    """The return below 0.7 of the first lesson's, short episodes, standing still, too few episodes."""
    curriculum = lessons()
    curriculum.update(rollout(1000.0))
    curriculum.update(worse)
    assert difficulty(curriculum) == pytest.approx(0.25)


def test_the_standard_is_that_of_the_first_lesson_once_it_is_learned() -> None:
    curriculum = lessons()
    curriculum.update(rollout(500.0, seconds=3.0))
    assert difficulty(curriculum) == 0.0
    curriculum.update(rollout(1000.0))
    assert curriculum.update(rollout(1500.0))["standard"] == 1000.0


def test_a_negative_standard_is_a_standard_too() -> None:
    curriculum = lessons()
    curriculum.update(rollout(-100.0))
    curriculum.update(rollout(-129.0))
    assert difficulty(curriculum) == pytest.approx(1 - 0.75**2)
    curriculum.update(rollout(-131.0))
    assert difficulty(curriculum) == pytest.approx(1 - 0.75**2)


@pytest.mark.parametrize(("target", "steps"), [(0.0, 0), (0.1, 1), (0.3, 2), (0.5, 3)])
def test_it_stops_at_the_tasks_difficulty(target: float, steps: int) -> None:
    curriculum = lessons(target)
    seen = []
    for _ in range(6):
        curriculum.update(rollout(1000.0))
        seen.append(difficulty(curriculum))
    assert seen[-1] == pytest.approx(target)
    assert len({0.0, *seen}) == steps + 1


def test_evaluations_stand_at_the_target() -> None:
    assert difficulty(lessons(0.6, evaluating=True)) == pytest.approx(0.6)


def test_one_episode_of_each_world_is_judged_at_least() -> None:
    curriculum = lessons(episodes=1)
    curriculum.update(rollout(1000.0, ends=3))
    assert difficulty(curriculum) == 0.0
    curriculum.update(rollout(1000.0, ends=1))
    assert difficulty(curriculum) == pytest.approx(0.25)


def test_the_training_ends_when_a_lesson_brings_nothing_more() -> None:
    """Counted anew in each lesson, whose returns are lower than those of the one before."""
    curriculum = lessons(target=0.25, patience=3)
    curriculum.update(rollout(1000.0))
    assert difficulty(curriculum) == 0.25
    for reward in (700.0, 600.0, 690.0, 710.0, 710.0, 705.0):
        curriculum.update(rollout(reward))
        assert not curriculum.finished()
    curriculum.update(rollout(700.0))
    assert curriculum.finished()
    endless = lessons(target=0.25)
    for _ in range(20):
        endless.update(rollout(500.0))
    assert not endless.finished()


def test_it_goes_on_where_it_was_saved() -> None:
    first, second = lessons(patience=2), lessons(patience=2)
    for _ in range(3):
        first.update(rollout(1000.0))
    first.update(rollout(900.0, ends=2))
    second.load_state_dict(first.state_dict())
    for curriculum in (first, second):
        curriculum.update(rollout(900.0, ends=2))
    assert difficulty(first) == difficulty(second) == pytest.approx(1 - 0.75**4)
    assert not second.finished()
    second.load_state_dict(first.state_dict())
    for curriculum in (first, second):
        curriculum.update(rollout(100.0))
        curriculum.update(rollout(100.0, ends=2))
        assert not curriculum.finished()
        curriculum.update(rollout(100.0, ends=2))
        assert curriculum.finished()
    assert first.state_dict()["standard"] == second.state_dict()["standard"] == 1000.0
