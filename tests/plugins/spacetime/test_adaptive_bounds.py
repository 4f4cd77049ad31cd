"""Bounds whose size adapts: wide where the motion fails, as they are meant to be where it does not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import pytest
import torch
from torch import Tensor

from understudy.random import WorldStreams
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.task import Context, Rollout
from understudy_reinforcement.job import Reinforcement
from understudy_spacetime.adaptive import AdaptiveBounds
from understudy_spacetime.bounds import BoundSize, ComBound

MakeRollout = Callable[[dict[str, Tensor], Tensor], Rollout]
OPTIONS = AdaptiveBounds.Options(widest=2.0, segments=4, fail_rate=0.1, rate=0.1)


def rollout(make_rollout: MakeRollout, failing: list[float]) -> Rollout:
    """100 decisions in each segment but the last, of which these shares fail."""
    phase = (torch.arange(3.0) / 4 + 0.1).repeat_interleave(100).view(1, -1)
    found = make_rollout({"phase": phase}, torch.zeros(1, 300))
    share = torch.arange(100) / 100.0
    found.failed = torch.cat([share < f for f in failing]).view(1, -1)
    return found


def scales(bounds: AdaptiveBounds) -> list[float]:
    given = bounds.begin(WorldStreams(0, "x", 16, "cpu"))["bound_scales"]
    assert given.shape == (16, 4)
    return given[3].tolist()


def test_segments_tighten_and_loosen_on_their_own(
    context: Context, make_rollout: MakeRollout
) -> None:
    bounds = AdaptiveBounds(OPTIONS, context)
    assert scales(bounds) == [2.0] * 4
    bounds.update(rollout(make_rollout, [0.0, 0.05, 0.5]))
    assert scales(bounds) == pytest.approx([1.8, 1.8, 2.0, 2.0])  # never wider, unseen as before
    bounds.update(rollout(make_rollout, [0.5, 0.05, 0.5]))
    assert scales(bounds) == pytest.approx([1.98, 1.62, 2.0, 2.0])
    for _ in range(20):
        metrics = bounds.update(rollout(make_rollout, [0.0, 0.0, 0.0]))
    assert scales(bounds) == pytest.approx([1.0, 1.0, 1.0, 2.0])  # never tighter than meant
    assert metrics == {"bound_scale": pytest.approx(1.25), "widest": 2.0}
    assert bounds.stage() == "bounds × 1.25"


def test_evaluations_have_the_bounds_as_they_are_meant(context: Context) -> None:
    assert scales(AdaptiveBounds(OPTIONS, replace(context, evaluating=True))) == [1.0] * 4


def test_its_state_goes_round_in_place(context: Context, make_rollout: MakeRollout) -> None:
    first, second = (AdaptiveBounds(OPTIONS, context) for _ in range(2))
    first.update(rollout(make_rollout, [0.0, 0.5, 0.0]))
    kept = second._scales
    second.load_state_dict(first.state_dict())
    assert second._scales is kept
    assert scales(second) == scales(first)


def test_a_bounds_size_is_scaled_where_the_motion_is(context: Context) -> None:
    phase = torch.tensor([0.1, 0.3, 0.6, 0.999999])
    given = torch.tensor([[1.0, 1.5, 2.0, 3.0]]).expand(4, 4)
    size = BoundSize([[0.0, 0.2], [1.0, 0.4]], "here", torch.device("cpu"))
    expected = torch.tensor([0.22, 0.26 * 1.5, 0.32 * 2.0, 0.4 * 3.0])
    torch.testing.assert_close(size.at(phase, given), expected)
    com = torch.tensor([[0.0, 0.0, 0.25]]).repeat(4, 1)
    left = ComBound(ComBound.Options(), context)(com, torch.zeros(4, 3), phase, given)
    assert left.tolist() == [True, False, False, False]


@pytest.mark.parametrize("options", [{"widest": 0.9}, {"segments": 0}, {"rate": 0.6}])
def test_impossible_options_are_refused(options: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(options))):
        AdaptiveBounds.Options(**options)


def test_it_trains() -> None:
    chosen = ["experiment=spacetime/walk", "curriculum=spacetime/adaptive_bounds", "num_worlds=8"]
    small = ["evaluation.episodes=2", "evaluation.seconds=0.1", "learner.minibatches=4"]
    training = Training(load_experiment([*chosen, *small, "learner.rollout_steps=8"])).prepare()
    row = training.iterate()
    assert 1.0 <= row["curriculum/bound_scale"] <= 2.0
    assert isinstance(training.job, Reinforcement)
    assert training.job.environment.table["bound_scales"].shape == (8, 20)
    assert training.job.evaluate("test", 2).episodes == 2
    training.close()
