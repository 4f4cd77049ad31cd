"""Evaluations that say where they begin: the first start decides, each is reported."""

from __future__ import annotations

from dataclasses import dataclass

import pytest
import torch
from counted_task import LINE_TASK, Steady, line_plugins
from torch import Tensor

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.setup.composition import load_experiment
from understudy.task import Context, InitialStates
from understudy_reinforcement.evaluation import Evaluation, wilson_interval
from understudy_reinforcement.evaluator import Evaluator


class At(InitialStates):
    """Every world at `place`."""

    @dataclass(frozen=True)
    class Options:
        place: float = 0.0

    def __init__(self, options: Options, context: Context) -> None:
        self._place, self._worlds = options.place, context.num_worlds

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {"x": torch.full((self._worlds, 1), self._place)}


def beyond(x: Tensor, *, limit: float) -> Tensor:
    return x[:, 0] >= limit


#: Each step moves every world by 1 for 4 s; from 0 it gets to 4, which is not too far.
TASK = (*LINE_TASK, "+termination.terms.far={name: my/beyond, limit: 5.0}")


def evaluated(*overrides: str, give_up_below: float | None = None) -> Evaluation:
    plugins = line_plugins(initial_states={"my/at": At}, termination={"my/beyond": beyond})
    made = Evaluator(load_experiment([*TASK, *overrides], plugins))
    built = made.built
    policy = Steady(Steady.Options(1.0), built.context)
    return made.run(policy, "test", 6, give_up_below=give_up_below)


STARTS = (
    "evaluation.starts.near={name: my/at, place: 0}",
    "evaluation.starts.farther={name: my/at, place: 2}",
)


def test_the_first_decides_and_each_is_reported() -> None:
    found = evaluated(*STARTS)
    assert found.success_rate == 1.0
    assert found.measures["success_from_near"].mean == 1.0
    assert found.measures["success_from_farther"].mean == 0.0
    assert found.row()["evaluation/success_from_farther"] == 0.0
    turned = evaluated(*reversed(STARTS))
    assert turned.success_rate == 0.0
    assert turned.measures["success_from_near"].mean == 1.0


def test_the_task_begins_elsewhere_and_does_not_matter() -> None:
    assert evaluated(*STARTS, "initial_states={name: my/at, place: 100}").success_rate == 1.0
    without = evaluated("initial_states={name: my/at, place: 100}")
    assert without.success_rate == 0.0
    assert not [name for name in without.measures if name.startswith("success_from")]


def test_a_criterion_looks_at_the_first_alone() -> None:
    found = evaluated(*STARTS, give_up_below=0.9)
    assert found.success_rate == 1.0
    assert not [name for name in found.measures if name.startswith("success_from")]


def test_an_unknown_start_is_named_with_its_place() -> None:
    with pytest.raises(ConfigError, match=r"evaluation\.starts\.near"):
        evaluated("evaluation.starts.near={name: my/art}")


def test_starts_are_kept_with_the_run() -> None:
    plugins = line_plugins(initial_states={"my/at": At}, termination={"my/beyond": beyond})
    effective = load_experiment([*TASK, *STARTS], plugins).effective()
    assert effective["evaluation"]["starts"] == {
        "near": {"name": "my/at", "place": 0.0},
        "farther": {"name": "my/at", "place": 2.0},
    }


class Apart(At):
    """Worlds at 0, 0.1, 0, 0.1, …"""

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {"x": 0.1 * (torch.arange(self._worlds) % 2).float()[:, None]}


def test_episodes_that_begin_alike_tell_as_much_as_one() -> None:
    found = evaluated("initial_states={name: my/at, place: 0.0}")
    assert (found.episodes, found.different_starts, found.trials) == (6, 1, 1)
    low, high = found.as_json(0)["success_rate_95"]
    assert (low, high) == pytest.approx(wilson_interval(1.0, 1))
    assert found.as_json(0)["different_starts"] == 1
    assert "the 6 episodes began in the same state, so they tell of it alone" in found.sentence()


def test_starts_beside_that_are_alike_tell_as_much_as_one() -> None:
    """The interval of their share was that of as many as there are worlds."""
    found = evaluated(*STARTS).measures["success_from_near"]
    assert (found.low, found.high) == pytest.approx(wilson_interval(1.0, 1))


def test_different_starts_are_counted() -> None:
    plugins = line_plugins(
        initial_states={"my/at": At, "my/apart": Apart}, termination={"my/beyond": beyond}
    )
    words = [*TASK, "initial_states={name: my/apart}"]
    made = Evaluator(load_experiment(words, plugins))
    found = made.run(Steady(Steady.Options(1.0), made.built.context), "test", 6)
    assert found.different_starts == 2
    assert "6 episodes began in 2 different states, so they tell of these alone" in found.sentence()


def test_nobody_counts_starts_of_an_evaluation_that_may_give_up() -> None:
    found = evaluated("initial_states={name: my/at, place: 0.0}", give_up_below=0.5)
    assert (found.different_starts, found.trials) == (None, 6)
