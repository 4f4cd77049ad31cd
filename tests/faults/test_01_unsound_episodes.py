"""Fault 1: episodes whose numbers go wrong are told of wherever a result is, and a training that has little
else stops with the name of the part."""

from __future__ import annotations

from types import ModuleType
from typing import Any

import pytest
import torch
from torch import Tensor
from worlds import SMALL, make_training

from understudy.errors import TrainingError
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import Context, Encoder
from understudy.testing import fake
from understudy.testing.fake import FAKE_TASK
from understudy_reinforcement.evaluation import Evaluation


def from_half(episode_time: Tensor, *, every: int = 1) -> Tensor:
    """1, and no number from 0.3 s of an episode on, in worlds of which there is one in `every`."""
    wrong = (episode_time > 0.3) & (torch.arange(len(episode_time)) % every == every - 1)
    return torch.where(wrong, torch.nan, 1.0)


class FromHalf(Encoder):
    reads = ("episode_time",)
    shape = (1,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, **fields: Tensor) -> Tensor:
        return from_half(fields["episode_time"]).unsqueeze(1)


def register(register: Registrar) -> None:
    register.component("reward", "wrong/reward", from_half)
    register.component("encoder", "wrong/encoder", FromHalf)


@pytest.fixture(scope="module")
def wrong() -> Plugins:
    module = ModuleType("wrong")
    module.understudy_register = hookimpl(register)  # type: ignore[attr-defined]
    return load(extra=[("fake", fake), ("wrong", module)])


TASK = (*FAKE_TASK, *SMALL, "episode.seconds=1", "evaluation.seconds=1", "budget.samples=20000",
        "evaluation.final_episodes=40", "termination=null")  # fmt: skip
PARTS = {
    "reward.terms.wrong": "+reward.terms.wrong={name: wrong/reward}",
    "encoder.wrong": "+encoder.wrong={name: wrong/encoder}",
    "two": "+reward.terms.wrong={name: wrong/reward} +reward.terms.other={name: wrong/reward}",
}


@pytest.mark.parametrize("part", PARTS)
def test_a_training_of_such_episodes_stops(wrong: Plugins, part: str) -> None:
    """By the name of the part, though less than a quarter of the steps are such."""
    training = make_training(wrong, [*TASK, *PARTS[part].split(" +")[:1]])
    named = r"reward\.terms\.wrong" if part == "two" else part.replace(".", r"\.")
    if part == "two":
        training = make_training(
            wrong, [*TASK, *(f"+{w.lstrip('+')}" for w in PARTS[part].split(" +"))]
        )
        named += r" and reward\.terms\.other"
    with pytest.raises(
        TrainingError, match=rf"% of all episodes ended in .* by the numbers of {named}\."
    ):
        training.train()
    assert training.progress.samples < 20000


def test_a_simulator_is_named(wrong: Plugins) -> None:
    training = make_training(wrong, [*TASK])
    simulator: Any = training.job.environment.parts.simulator  # type: ignore[attr-defined]
    failed = simulator.failed
    age = training.job.environment.table  # type: ignore[attr-defined]
    simulator.failed = lambda: failed() | (age["episode_time"] > 0.3)
    with pytest.raises(TrainingError, match="by the numbers of the actuation or the simulator"):
        training.train()


def test_a_training_of_some_goes_on(wrong: Plugins) -> None:
    """A third of all episodes, those of every eighth world, which end early."""
    words = [*TASK, "budget.samples=5500", "+reward.terms.wrong={name: wrong/reward, every: 8}"]
    training = make_training(wrong, words)
    assert training.train() == "budget"
    assert training.iterate()["episode/unsound"] > 0


def judged(wrong: Plugins, *more: str) -> Evaluation:
    training = make_training(wrong, [*TASK, *more])
    evaluation, _ = training.judge()
    training.close()
    return evaluation


def test_their_share_is_told(wrong: Plugins) -> None:
    whole = judged(wrong, PARTS["reward.terms.wrong"])
    assert whole.unsound == 1.0
    assert whole.as_json(0)["unsound"] == 1.0
    assert whole.row()["evaluation/unsound"] == 1.0
    assert "numbers went wrong in 100% of the episodes" in whole.sentence()
    half = judged(wrong, "+reward.terms.wrong={name: wrong/reward, every: 2}")
    assert half.unsound == 0.5
    assert "numbers went wrong in 50% of the episodes" in half.sentence()
    none = judged(wrong)
    assert none.unsound == none.as_json(0)["unsound"] == 0.0
    assert "evaluation/unsound" not in none.row()
    assert "went wrong" not in none.sentence()


def test_few_of_them_are_some() -> None:
    assert "wrong in under 1% of" in Evaluation(1000, "", 0.5, unsound=0.001).sentence()
    assert "wrong in over 99% of" in Evaluation(1000, unsound=0.999).sentence()
