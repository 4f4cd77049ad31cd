"""Difficulty that rises, what follows from it, and that it continues exactly."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
import torch
from torch.testing import assert_close

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy.random import WorldStreams
from understudy.task import Context, Rollout
from understudy_curricula.curricula import Adaptive, Knots, Linear

STREAMS = WorldStreams(0, "test", 2, "cpu")


def context(**more: Any) -> Context:
    return Context(0, torch.device("cpu"), 2, control_dt=0.1, substeps=1, **more)


def rollout(ended: int, succeeded: int, returns: float = 0.0) -> Rollout:
    """Five steps of two worlds, in whose first ones `ended` episodes end."""
    none = torch.zeros(10, dtype=torch.bool)
    ends, wins = none.clone(), none.clone()
    ends[:ended] = True
    wins[:succeeded] = True
    flags = [v.view(5, 2) for v in (wins | (ends & ~wins), none, ends & ~wins)]
    zero = torch.zeros(5, 2)
    return Rollout(
        {}, {}, zero, zero, zero, flags[0], flags[1], flags[2], zero,
        torch.where(flags[0], returns, 99.0), {},
    )  # fmt: skip


def test_linear_reaches_the_tasks_difficulty_and_says_so_once() -> None:
    curriculum = Linear(Linear.Options(samples=40, start=0.2), context(difficulty=0.8))
    found = [curriculum.update(rollout(0, 0)) for _ in range(6)]
    assert [round(f["difficulty"], 6) for f in found] == [0.35, 0.5, 0.65, 0.8, 0.8, 0.8]
    assert [sorted(f) for f in found[3:5]] == [
        ["difficulty", "mark/difficulty 0.80"],
        ["difficulty"],
    ]


@pytest.mark.parametrize(("by", "low", "high"), [("success", 1, 3), ("return", 2, 2)])
def test_adaptive_rises_only_when_enough_episodes_went_well(by: Any, low: int, high: int) -> None:
    threshold = 0.7 if by == "success" else 5.0
    options = Adaptive.Options(threshold=threshold, by=by, step=0.4, episodes=8)
    curriculum = Adaptive(options, context())

    def rises(wins: int, returns: float) -> bool:
        before = curriculum.begin(STREAMS)["difficulty"].clone()
        for _ in range(2):
            curriculum.update(rollout(4, wins, returns))
        return bool((curriculum.begin(STREAMS)["difficulty"] > before).all())

    def end_older() -> None:
        curriculum.update(rollout(2, 0, 0.0))

    assert not rises(low, 4.0)
    assert rises(high, 6.0)
    end_older()
    assert rises(high, 6.0)
    end_older()
    assert rises(high, 6.0)
    end_older()
    assert not rises(high, 6.0)  # it is the task's by now
    assert curriculum.begin(STREAMS)["difficulty"].tolist() == [1.0, 1.0]


def test_adaptive_begins_with_the_tasks_difficulty_at_most() -> None:
    options = Adaptive.Options(threshold=0.5, start=0.3)
    assert Adaptive(options, context(difficulty=0.3)).difficulty == 0.3
    with pytest.raises(ConfigError, match=r"curriculum\.start=0\.3 is beyond difficulty=0\.2"):
        Adaptive(options, context(difficulty=0.2))
    assert Adaptive(options, context(difficulty=0.2, evaluating=True)).difficulty == 0.2


def test_episodes_that_began_before_a_step_do_not_count_after_it() -> None:
    options = Adaptive.Options(threshold=0.5, by="return", step=0.25, episodes=2)
    curriculum = Adaptive(options, context())
    assert curriculum.update(rollout(2, 0, 1.0))["difficulty"] == 0.25
    # One world each time: its episode of before, which went well, and none of the other's.
    assert "return" not in curriculum.update(rollout(1, 0, 1.0))
    found = curriculum.update(rollout(4, 0, 0.25))  # the other world's older one is among these
    assert (found["return"], found["difficulty"]) == (0.25, 0.25)
    assert curriculum.update(rollout(2, 0, 1.0))["difficulty"] == 0.5


def test_only_episodes_that_a_field_names_count() -> None:
    """World 0 is asked for the newest lesson and fails, world 1 repeats an old one."""
    options = Adaptive.Options(threshold=0.5, by="return", step=0.25, episodes=2, counts="newest")
    curriculum = Adaptive(options, context())
    assert curriculum.rollout_fields == ("newest",)
    both = rollout(4, 0, 1.0)
    returns = both.episode_returns
    returns[:, 0] = 0.0
    both.fields["newest"] = torch.tensor([1.0, 0.0]).expand_as(returns)
    found = curriculum.update(both)
    assert (found["return"], found["difficulty"]) == (0.0, 0.0)
    both.fields["newest"] = torch.tensor([0.0, 1.0]).expand_as(returns)
    assert curriculum.update(both)["difficulty"] == 0.25


def test_knots_decide_rate_and_limit() -> None:
    knots = Knots(decision=((0.0, 8), (0.5, 4), (1.0, 1)), episode_limit=((0.0, 2.0), (1.0, 6.0)))
    curriculum = Linear(Linear.Options(samples=100, knots=knots), context())
    seen = []
    for _ in range(11):
        limit = float(curriculum.begin(STREAMS)["episode_limit"][0])
        seen.append((curriculum.decision(), round(limit, 4)))
        curriculum.update(rollout(0, 0))
    assert seen[0] == (8, 2.0)
    assert seen[4] == (8, 3.6)
    assert seen[5] == (4, 4.0)
    assert seen[10] == (1, 6.0)


def test_evaluations_stand_at_the_tasks_difficulty() -> None:
    knots = Knots(decision=((0.0, 8), (0.5, 4)))
    for curriculum in (
        Linear(Linear.Options(samples=10, knots=knots), context(evaluating=True, difficulty=0.6)),
        Adaptive(Adaptive.Options(threshold=1, knots=knots), context(evaluating=True, difficulty=0.6)),
    ):  # fmt: skip
        assert curriculum.begin(STREAMS)["difficulty"].tolist() == pytest.approx([0.6, 0.6])
        assert curriculum.decision() == 4


def test_state_continues_exactly_and_in_place() -> None:
    options = Adaptive.Options(threshold=0.5, episodes=6, step=0.3)
    one, two = Adaptive(options, context()), Adaptive(options, context())
    where = two.begin(STREAMS)["difficulty"].data_ptr()
    for _ in range(2):
        one.update(rollout(4, 3))
    one.update(rollout(1, 0))
    state = one.state_dict()
    assert state["older"] == [1]
    two.load_state_dict(state)
    for _ in range(4):
        assert one.update(rollout(4, 3)) == two.update(rollout(4, 3))
    assert_close(dict(one.state_dict()), dict(two.state_dict()), rtol=0, atol=0)
    assert two.begin(STREAMS)["difficulty"].data_ptr() == where
    alone = Adaptive(options, replace(context(), num_worlds=1))
    alone.load_state_dict(one.state_dict())
    assert alone.stage() == one.stage(), "of fewer worlds, too"


@pytest.mark.parametrize(
    "knots", [{"decision": [[0.5, 4], [0.5, 2]]}, {"episode_limit": [[0.0, 0.0]]}]
)
def test_knots_that_make_no_sense_are_refused(knots: dict[str, Any]) -> None:
    with pytest.raises(ConfigError, match="is not possible"):
        make_options(Knots, knots, "curriculum.knots")
