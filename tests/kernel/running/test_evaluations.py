"""Evaluations: measures reduced over episodes, successes and objectives, on numbers worked out by hand."""

from __future__ import annotations

import math
import statistics
from collections.abc import Iterable
from pathlib import Path
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, Starts, Steady, line_plugins
from torch import Tensor
from worlds import make_training

from understudy.errors import ConfigError
from understudy.random import WorldStreams
from understudy.setup.composition import load_experiment
from understudy.task.terms import Reduction
from understudy_reinforcement.evaluation import Evaluation, Measured, wilson_interval
from understudy_reinforcement.evaluator import Evaluator, Reducer
from understudy_reinforcement.success import Success, success_of

VALUES = torch.tensor([[3.0, 0.0, -1.0], [1.0, 0.0, -4.0], [2.0, 0.0, 0.0]])  # (T, N)


@pytest.mark.parametrize(
    ("reduce", "expected", "short"),
    [
        ("last", [2, 0, 0], [1, 0, -4]),
        ("min", [1, 0, -4], [1, 0, -4]),
        ("max", [3, 0, 0], [3, 0, -1]),
        ("mean", [2, 0, -5 / 3], [2, 0, -2.5]),
        ("sum", [6, 0, -5], [4, 0, -5]),
        ("any", [1, 0, 1], [1, 0, 1]),
    ],
)
def test_reductions(reduce: Reduction, expected: list[float], short: list[float]) -> None:
    reducer = Reducer(reduce, 3, torch.device("cpu"))
    for running, result in (([True] * 3, expected), ([False] * 3, short), ([True] * 3, expected)):
        reducer.start()
        for value, counts in zip(VALUES, ([True] * 3, [True] * 3, running), strict=True):
            reducer.digest(value, torch.tensor(counts))
        assert reducer.result().tolist() == pytest.approx(result)


@pytest.mark.parametrize("kind", [torch.bool, torch.int64, torch.float32])
def test_what_is_no_number_is_not_true_of_any_step(kind: torch.dtype) -> None:
    """As the least of numbers, of which one is none, is none."""
    reducer = Reducer("any", 3, torch.device("cpu"))
    reducer.start()
    for row in ([0, 1, 0], [0, 0, 0]):
        reducer.digest(torch.tensor(row).to(kind), torch.tensor([True] * 3))
    assert reducer.result().tolist() == [0, 1, 0]
    reducer.digest(torch.tensor([math.nan, 0.0, 0.0]), torch.tensor([True] * 3))
    assert reducer.result()[0].isnan()
    assert reducer.result()[1:].tolist() == [1, 0]


def test_measured() -> None:
    values = [1.0, 2.0, 4.0, 9.0]
    found = Measured.of("last", torch.tensor([*values, math.inf]))
    mean, spread = statistics.fmean(values), statistics.stdev(values)
    assert (found.mean, found.spread) == (mean, pytest.approx(spread))
    reach = 3.182446 * spread / 2  # Student's t at 0.975, three degrees of freedom
    assert found.low == pytest.approx(mean - reach)
    assert found.high == pytest.approx(mean + reach)
    none = Measured.of("min", torch.tensor([math.inf, math.nan]))
    assert math.isnan(none.mean)
    assert none.as_json()["mean"] is None
    unknown = Evaluation(2, measures={"least": none, "return": none}, objective="least")
    assert unknown.objective_value is None, "a measure that no episode has is not 0"
    assert unknown.sentence() == "nothing was measured."


@pytest.mark.parametrize(
    ("values", "starts"),
    [([3.0], None), ([3.0], 1), ([3.0] * 128, 1), ([1.0, 2.0, 4.0], 1), ([3.0, math.nan], None)],
)
def test_one_episode_says_nothing_of_others(values: list[float], starts: int | None) -> None:
    """Nor do many from the same state: the interval had no width, as if the mean were certain."""
    found = Measured.of("last", torch.tensor(values), starts).as_json()
    assert found["mean_95"] is None
    assert found["mean"] == pytest.approx(statistics.fmean(v for v in values if v == v))


@pytest.mark.parametrize("starts", [2, 5, 64])
def test_intervals_are_of_the_states_in_which_episodes_began(starts: int) -> None:
    """Two from each: no narrower than of one from each, of means and of shares."""
    values = torch.linspace(0.0, 3.0, starts, dtype=torch.float64)
    for reduce, one in (("last", values), ("any", (values > 1).double())):
        once, twice = Measured.of(reduce, one), Measured.of(reduce, one.repeat(2), starts)
        assert twice.mean == pytest.approx(once.mean)
        width = once.high - once.low
        assert twice.high - twice.low > 0.69 * width, "the spread of each is estimated"
        counted = Measured.of(reduce, one.repeat(2))
        assert twice.high - twice.low > counted.high - counted.low


def test_intervals_of_few_episodes_hold() -> None:
    """95 of a hundred times, also for two and for five episodes; 1.96 standard errors held for 70 and 88."""
    draws = torch.randn(4000, 5, generator=torch.Generator().manual_seed(0)).double()
    for n in (2, 5):
        found = [Measured.of("mean", row[:n]) for row in draws]
        held = statistics.fmean(one.low <= 0.0 <= one.high for one in found)
        assert held == pytest.approx(0.95, abs=0.012)


@pytest.mark.parametrize("reduce", ["any", "min", "max"])
def test_a_share_of_episodes_has_an_interval_that_is_possible(reduce: Reduction) -> None:
    most = Measured.of(reduce, torch.tensor([1.0] * 511 + [0.0]))
    assert most.mean == pytest.approx(511 / 512)
    assert 0 < most.low < most.mean < most.high <= 1
    lengths = Measured.of(reduce, torch.tensor([0.0, 0.9])) if reduce != "any" else most
    assert reduce == "any" or lengths.low < 0  # of other numbers nothing is known


@pytest.mark.parametrize(
    ("rate", "n", "low", "high"),  # Newcombe 1998, table I, method 3, and the limits
    [(81 / 263, 263, 0.2553, 0.3662), (15 / 148, 148, 0.0624, 0.1605), (0, 20, 0, 0.1611), (1 / 29, 29, 0.0061, 0.1718), (0, 0, 0, 1)],
)  # fmt: skip
def test_wilson_interval(rate: float, n: int, low: float, high: float) -> None:
    assert wilson_interval(rate, n) == pytest.approx((low, high), abs=1e-4)


# ---------------------------------------------------------------------- a task known by heart


class Rungs(Starts):
    """World i begins at i."""

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        x = torch.arange(float(len(streams.uniform(1)))).unsqueeze(1)
        self.taken.append(x)
        return {"x": x}


def rewarded(reward: Tensor) -> Tensor:
    """What the step gave."""
    return reward


#: All worlds move by one a second for four seconds: world i is at i + 1, i + 2, i + 3, i + 4.
RUNGS = (*LINE_TASK, "initial_states={name: my/rungs}")
PARTS = {"initial_states": {"my/rungs": Rungs}, "measure": {"my/rewarded": rewarded}}


def evaluator(*overrides: str, task: Iterable[str] = RUNGS) -> Evaluator:
    return Evaluator(load_experiment([*task, *overrides], line_plugins(**PARTS)))


def evaluated(*overrides: str, episodes: int = 4, task: Iterable[str] = RUNGS) -> Evaluation:
    made = evaluator(*overrides, task=task)
    return made.run(policy(), "a", episodes)


@pytest.mark.parametrize(("last", "worlds"), [(2, 2), (9, 3)])
def test_no_more_worlds_are_simulated_than_are_ever_judged(last: int, worlds: int) -> None:
    """Four episodes of an evaluation took as long as thirty-two."""
    made = evaluator("evaluation.episodes=3", f"evaluation.final_episodes={last}")
    assert made.built.environment.num_worlds == worlds


def policy(push: float = 1.0) -> Steady:
    """Moves worlds by `push` a second."""
    return Steady(Steady.Options(float(push)))


def far(limit: float, outcome: str = "failure", name: str = "far") -> str:
    return f"+termination.terms.{name}={{name: line/beyond, limit: {limit}, outcome: {outcome}}}"


def test_survival() -> None:
    """World 3 reaches 7 in its last step, world 2 does not; an episode ends with its failure."""
    found = evaluated(
        far(6), "+measure.at={name: line/value}", "+measure.low={name: line/value, reduce: min}"
    )
    assert (found.episodes, found.success_rate, found.complete) == (4, 0.5, True)
    assert found.success == "survived 4 s without far"
    assert found.violated == {"far": 0.5}
    assert found.mean_episode_seconds == (4 + 4 + 4 + 3) / 4
    at, low, back = found.measures["at"], found.measures["low"], found.measures["return"]
    values = [4.0, 5.0, 6.0, 6.0]
    assert (at.reduce, at.mean) == ("last", statistics.fmean(values))
    assert at.spread == pytest.approx(statistics.stdev(values))
    assert at.high - at.mean == pytest.approx(3.182446 * statistics.stdev(values) / 2)
    assert (low.reduce, low.mean) == ("min", (1 + 2 + 3 + 4) / 4)
    returns = [1 + 2 + 3 + 4, 2 + 3 + 4 + 5, 3 + 4 + 5 + 6, 4 + 5 + 6]
    assert (back.reduce, back.mean) == ("sum", statistics.fmean(returns))
    assert (found.objective, found.objective_value) == ("success_rate", 0.5)


def test_rewards_can_be_measured() -> None:
    found = evaluated(far(6), "+measure.all={name: my/rewarded, reduce: sum}").measures
    best = evaluated(far(6), "+measure.best={name: my/rewarded, reduce: max}").measures["best"]
    assert found["all"] == found["return"]
    assert best.mean == (4 + 5 + 6 + 6) / 4


@pytest.mark.parametrize(("watched", "steps"), [(False, 30), (True, 100)])
def test_an_evaluation_is_over_when_all_episodes_are(watched: bool, steps: int) -> None:
    """The last world falls in its sixth second; who watches sees what comes then."""
    made, seen = evaluator(far(6), "evaluation.seconds=100"), []
    found = made.run(policy(), "a", 4, on_period=seen.append if watched else None)
    assert len(made.built.environment.parts.simulator.calls) == steps
    assert len(seen) == (steps if watched else 0)
    assert found.mean_episode_seconds == (6 + 5 + 4 + 3) / 4


def test_what_is_written_of_it() -> None:
    found = evaluated(far(6), "+measure.at={name: line/value}", "evaluation.objective=at").as_json(
        96
    )
    assert found["success_rate_95"] == list(wilson_interval(0.5, 4))
    assert (found["samples"], found["episodes"], found["seconds"]) == (96, 4, 4.0)
    assert found["violated"] == {"far": 0.5}
    assert found["objective"] == {"name": "at", "value": 5.25}
    assert set(found["measures"]) == {"at", "return"}
    assert set(found["measures"]["at"]) == {"reduce", "mean", "spread", "mean_95"}


def test_failures_that_only_report() -> None:
    """``evaluation.failures`` names those that end an episode; the others are counted."""
    found = evaluated(far(6), far(4, name="near"), "evaluation.failures=[far]")
    assert found.success_rate == 0.5
    assert found.violated == {"far": 0.5, "near": 1.0}
    assert evaluated(far(6), far(4, name="near")).success_rate == 0.0


def test_what_ended_early_and_is_no_failure_is_told() -> None:
    found = evaluated(far(6, "truncation", "end"), far(100))
    assert (found.success_rate, found.violated, found.cut) == (1.0, {"far": 0.0}, {"end": 0.5})
    assert found.as_json(96)["cut"] == {"end": 0.5}
    assert "(survived 4 s without far); end cut 50% short; on average they lasted 3.75 s" in (
        found.sentence()
    )
    assert "cut" not in evaluated(far(100, "truncation", "end"), far(100)).sentence()


def test_a_success_term_ends_episodes_and_is_the_success() -> None:
    found = evaluated(far(6, "success", "there"), far(100), "+measure.at={name: line/value}")
    assert found.success == "there within 4 s"
    assert found.success_rate == 0.5
    assert found.mean_episode_seconds == (4 + 4 + 4 + 3) / 4
    assert found.measures["at"].mean == (4 + 5 + 6 + 6) / 4


def test_survival_beside_a_success_term() -> None:
    """Worlds that come to an end by success survived."""
    found = evaluated(far(6, "success", "there"), far(100), "evaluation.success=survived")
    assert found.success_rate == 1.0
    assert (
        evaluated(far(6, "success", "there"), far(2), "evaluation.success=survived").success_rate
        == 0.0
    )


def test_a_failure_in_the_same_step_is_no_success_term_of_another() -> None:
    """Of two success terms the named one counts."""
    overrides = (far(6, "success", "there"), far(7, "success", "further"))
    assert evaluated(*overrides).success == "there within 4 s", "the first one"
    found = evaluated(*overrides, "evaluation.success=further")
    assert found.success_rate == 0.0, "all that reach 6 end there"


def test_what_fails_in_the_step_of_a_success_term_is_none() -> None:
    """As in training."""
    found = evaluated(far(6, "success", "there"), far(6, "failure", "fell"))
    assert (found.success_rate, found.violated) == (0.0, {"fell": 0.5})


@pytest.mark.parametrize("step", [1, 3])
def test_an_episode_that_went_wrong_is_no_success_by_what_was_measured_before(step: int) -> None:
    made = evaluator(
        far(50), "+measure.at={name: line/value}", "evaluation.success={measure: at, at_most: 9}"
    )
    assert made.run(policy(), "a", 4).success_rate == 1.0
    seen = 0

    def harm(counted: Tensor) -> None:
        nonlocal seen
        seen += 1
        if seen == step:
            made.built.environment.parts.simulator.read("x")[:2] = math.nan

    found = made.run(policy(), "a", 4, on_period=harm)
    assert found.success_rate == 0.5


def test_shares_of_starts_have_an_interval_of_a_share() -> None:
    found = evaluated(far(50), "evaluation.starts.here={name: my/rungs}").measures[
        "success_from_here"
    ]
    assert (found.mean, found.low < 0.7, found.high) == (1.0, True, pytest.approx(1.0))


@pytest.mark.parametrize(
    ("limits", "rate", "text"),
    [
        ("at_least: 6", 0.5, "at at least 6"),
        ("at_most: 6", 0.75, "at at most 6"),
        ("at_least: 5, at_most: 6", 0.5, "at at least 5 and at most 6"),
    ],
)
def test_success_by_a_measure(limits: str, rate: float, text: str) -> None:
    found = evaluated(
        "+measure.at={name: line/value}", f"evaluation.success={{measure: at, {limits}}}"
    )
    assert (found.success_rate, found.success) == (rate, text)


def test_success_by_the_return() -> None:
    found = evaluated("evaluation.success={measure: return, at_least: 14}")
    assert found.success_rate == 0.75


def test_success_is_of_measures_over_the_whole_episode() -> None:
    found = evaluated(
        "+measure.at={name: line/value, reduce: max}", far(5, "truncation"),
        "evaluation.success={measure: at, at_least: 5}",
    )  # fmt: skip
    assert found.success_rate == 0.75


def test_nothing_is_a_success() -> None:
    found = evaluated("+measure.at={name: line/value}")
    assert (found.success_rate, found.success) == (None, "")
    assert "success_rate" not in found.as_json(0)
    assert "evaluation/success_rate" not in found.row()
    assert found.row() == {"evaluation/at": 5.5, "evaluation/return": (10 + 14 + 18 + 22) / 4}
    assert found.sentence() == "at 5.5."


@pytest.mark.parametrize(
    ("overrides", "expected"),
    [
        ((), None),
        ((far(6, "report"),), None),
        ((far(6),), "survived"),
        ((far(6), far(7, "success", "there")), "there"),
        ((far(7, "success", "there"),), "there"),
        ((far(6), "evaluation.failures=[]"), None),
    ],
)
def test_what_counts_if_nothing_is_said(overrides: tuple[str, ...], expected: str | None) -> None:
    found = success_of(load_experiment([*LINE_TASK, *overrides], line_plugins()))
    if expected is None:
        assert found is None
    else:
        assert isinstance(found, Success)
        assert (found.term or "survived", found.measure) == (expected, None)


@pytest.mark.parametrize(
    ("overrides", "message"),
    [
        (("evaluation.success=survived",), r"survived cannot be judged: no termination term is a failure"),
        ((far(6, "report"), "evaluation.success=survived"), r"survived cannot be judged"),
        ((far(6), "evaluation.success=far"), r"=far names no termination term with outcome=success"),
        (("evaluation.success=nothing",), r"=nothing names no termination term with outcome=success"),
        (("+measure.at={name: line/value}", "evaluation.success={measure: at, at_least: 5, at_most: 1}"), r"at_least=5 is not possible: it is more than at_most=1"),
        (("evaluation.success={measure: at, at_least: 1}",), r"^evaluation\.success\.measure names 'at', which is no measure of this task"),
    ],
)  # fmt: skip
def test_success_that_cannot_be_judged(overrides: tuple[str, ...], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        evaluator(*overrides, task=LINE_TASK)
    with pytest.raises(ConfigError, match=message):  # and before it trains
        make_training(line_plugins(), [*LINE_TASK, *overrides])


def test_a_criterion_without_a_success_is_told_of() -> None:
    """A training said that it went on until so many succeed, and nothing could."""
    for more, told in (((), True), ((far(6),), False)):
        training = make_training(line_plugins(), [*LINE_TASK, "evaluation.criterion=0.5", *more])
        said = " ".join(training.job.notes())
        assert ("evaluation.criterion=0.5 is never met: nothing in this task says" in said) is told
        training.close()


# ---------------------------------------------------------------------- draws


#: Starts are drawn from a million numbers; nothing moves.
DRAWN = (*LINE_TASK, "+measure.at={name: line/value}", "+initial_states.count=1000000")


def taken(made: Evaluator) -> list[Tensor]:
    initial: Any = made.built.environment.parts.initial_states
    return [x.flatten() for x in initial.taken]


def test_draws_repeat_exactly_and_differ_from_each_other_and_from_training() -> None:
    training = make_training(line_plugins(), DRAWN)
    for _ in range(4):
        training.iterate()
    used = {float(x) for t in training.job.environment.parts.initial_states.taken for x in t}
    made = evaluator(task=DRAWN)
    starts, figures = {}, {}
    with torch.no_grad():
        training.job.policy.push.zero_()
    for draw in ("evaluation/1", "evaluation/2", "confirmation/1", "final"):
        before = len(taken(made))
        figures[draw] = made.run(training.job.policy, draw, 4)
        starts[draw] = taken(made)[before].tolist()
    assert len({x for found in starts.values() for x in found}) == 16
    assert not used & {x for found in starts.values() for x in found}
    for draw, found in starts.items():
        assert figures[draw].measures["at"].mean == pytest.approx(statistics.fmean(found))
        assert evaluator(task=DRAWN).run(training.job.policy, draw, 4) == figures[draw]
    made.run(training.job.policy, "evaluation/2", 4)
    assert made.run(training.job.policy, "final", 4) == figures["final"]


def test_another_seed_draws_other_starts() -> None:
    one, two = (evaluator(f"seed={seed}", task=DRAWN) for seed in (0, 1))
    still = policy(0)
    assert one.run(still, "final", 4) != two.run(still, "final", 4)


@pytest.mark.parametrize("episodes", [1, 4, 6, 8, 11])
def test_several_batches_are_one_evaluation(episodes: int) -> None:
    """Of the last batch as many worlds count as episodes are missing."""
    made = evaluator(far(500_000), task=DRAWN)
    found = made.run(policy(0), "a", episodes)
    batches = taken(made)[:: len(taken(made)) // math.ceil(episodes / 4)]
    starts = torch.cat(batches)[:episodes].tolist()
    assert found.episodes == episodes
    assert len(set(starts)) == episodes
    at = found.measures["at"]
    assert at.mean == pytest.approx(statistics.fmean(starts))
    if episodes > 1:
        assert at.spread == pytest.approx(statistics.stdev(starts))
    assert found.violated == {"far": pytest.approx(sum(x >= 500_000 for x in starts) / episodes)}
    assert found.success_rate == pytest.approx(sum(x < 500_000 for x in starts) / episodes)


@pytest.mark.parametrize(
    ("criterion", "complete", "rate"), [(0.5, True, 0.5), (0.75, False, 0.5), (1.0, False, 0.75)]
)
def test_giving_up_when_success_is_out_of_reach(
    criterion: float, complete: bool, rate: float
) -> None:
    """Two of four worlds fail in each batch at once: 4 of 8, 2 more than 0.75 allows, or in the first
    batch already 2 more than 1.0 allows; the second batch could still succeed."""
    made = evaluator(far(6), "evaluation.seconds=60", "+measure.at={name: line/value}")
    still = policy(0)
    made.built.environment.parts.initial_states.sample = (  # type: ignore[method-assign]
        lambda streams, **fields: {"x": torch.tensor([[0.0], [6.0], [0.0], [7.0]])}
    )
    found = made.run(still, "a", 8, give_up_below=criterion)
    assert (found.complete, found.episodes, found.success_rate) == (complete, 8, rate)
    if complete:
        assert found.row()["evaluation/success_rate"] == rate
    else:
        assert found.row() == {"evaluation/success_rate_at_most": rate}
        assert f"at most {rate:.0%} of 8 episodes succeeded, stopped early" in found.sentence()


def test_a_success_term_that_may_still_come_is_not_out_of_reach() -> None:
    """Stopped early, worlds that are still running count as if they reached the term."""
    made = evaluator(far(9, "success", "there"), far(6), "evaluation.seconds=60")
    made.built.environment.parts.initial_states.sample = (  # type: ignore[method-assign]
        lambda streams, **fields: {"x": torch.tensor([[0.0], [6.0], [0.0], [7.0]])}
    )
    found = made.run(policy(0), "a", 4, give_up_below=0.75)
    assert (found.complete, found.success_rate) == (False, 0.5)


@pytest.mark.parametrize(
    ("limit", "criterion", "complete"),
    [("at_most", 0.5, True), ("at_most", 0.75, False), ("at_least", 0.75, True)],
)
def test_what_a_measure_says_of_episodes_that_are_over_is_final(
    limit: str, criterion: float, complete: bool
) -> None:
    """Two of four end at once with a large measure; that of the others, who go on, may still grow."""
    made = evaluator(
        far(6),
        "evaluation.seconds=60",
        "+measure.at={name: line/value}",
        f"evaluation.success={{measure: at, {limit}: 1}}",
    )
    made.built.environment.parts.initial_states.sample = (  # type: ignore[method-assign]
        lambda streams, **fields: {"x": torch.tensor([[0.0], [6.0], [0.0], [7.0]])}
    )
    found = made.run(policy(0), "a", 4, give_up_below=criterion)
    assert (found.complete, found.success_rate) == (complete, 0.5)


def test_evaluations_that_are_not_given_up_record_their_measures(tmp_path: Path) -> None:
    """Two of four worlds fail at once, so that the criterion is out of reach."""
    overrides = [*LINE_TASK, far(600), "evaluation.criterion=0.9", "evaluation.every_samples=0", "evaluation.gate=0", "evaluation.seconds=60", "evaluation.episodes=4", "budget.samples=16"]  # fmt: skip
    for give_up in (True, False):
        own = [*overrides, f"evaluation.give_up={give_up}"]
        training = make_training(line_plugins(), own, tmp_path / str(give_up))
        starts = training.job.evaluator.built.environment.parts.initial_states
        starts.sample = lambda streams, **fields: {
            "x": torch.tensor([[0.0], [600.0], [0.0], [700.0]])
        }
        training.train()
        row = training.run.metrics()[0]
        assert ("evaluation/success_rate_at_most" in row) is give_up
        assert ("evaluation/return" in row) is not give_up


def test_only_first_episodes_count() -> None:
    """Worlds 2 and 3 succeed early, and what they begin with next fails at once."""
    made = evaluator(far(5, "success", "there"), far(50), "+measure.at={name: line/value}")
    initial: Any = made.built.environment.parts.initial_states
    first = initial.sample

    def sample(streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        again = bool(initial.taken)
        return {"x": first(streams)["x"] + 100 * again}

    initial.sample = sample
    found = made.run(policy(), "a", 4)
    assert found.success_rate == 0.75
    assert found.violated["far"] == 0
    assert found.mean_episode_seconds == (4 + 4 + 3 + 2) / 4
    assert found.measures["at"].mean == (4 + 5 + 5 + 5) / 4
    returns = [1 + 2 + 3 + 4, 2 + 3 + 4 + 5, 3 + 4 + 5, 4 + 5]
    assert found.measures["return"].mean == statistics.fmean(returns)


@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e12])
def test_what_a_world_measures_when_its_numbers_go_wrong_does_not_count(value: float) -> None:
    """World 1 was at 1 + 1 and 1 + 2 before."""
    made = evaluator(
        far(50), "+measure.at={name: line/value}", "+measure.high={name: line/value, reduce: max}"
    )
    steps: list[Tensor] = []

    def harm(counted: Tensor) -> None:
        steps.append(counted)
        if len(steps) == 3:
            made.built.environment.parts.simulator.read("x")[1] = value

    found = made.run(policy(), "a", 4, on_period=harm)
    assert found.success_rate == 0.75
    assert found.measures["at"].mean == (4 + 3 + 6 + 7) / 4
    assert found.measures["high"].mean == (4 + 3 + 6 + 7) / 4
    assert found.measures["return"].mean == (10 + (2 + 3) + 18 + 22) / 4


def test_evaluations_before_are_no_matter() -> None:
    """Nothing of an evaluation is left in the next one."""
    made = evaluator(far(6))
    pushing, still = policy(), policy(0)
    first = made.run(still, "a", 4)
    assert first.success_rate == 1.0
    assert made.run(pushing, "a", 4).success_rate == 0.5
    assert made.run(still, "a", 4) == first


# ---------------------------------------------------------------------- the criterion


def test_the_criterion_needs_both_draws(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A policy that passes the first draw and fails the second goes on, and is judged on new draws."""
    overrides = [*LINE_TASK, far(6), "evaluation.criterion=0.9", "evaluation.every_samples=0", "evaluation.gate=0", "budget.samples=800"]  # fmt: skip
    training = make_training(line_plugins(), overrides, tmp_path / "run")
    asked: list[tuple[str, int]] = []
    answers = iter([0.5, 1.0, 0.8, 0.95, 0.9])

    def evaluate(draw: str, episodes: int, *, give_up_below: float | None = None) -> Evaluation:
        asked.append((draw, episodes))
        assert give_up_below == 0.9
        return Evaluation(episodes, "", next(answers))

    monkeypatch.setattr(training.job, "evaluate", evaluate)
    assert training.train() == "criterion"
    assert [draw for draw, _ in asked] == [
        "evaluation/1",
        "evaluation/2",
        "confirmation/2",
        "evaluation/3",
        "confirmation/3",
    ]
    assert training.progress.iteration == 3
    rows = training.run.metrics()
    assert [row["evaluation/success_rate"] for row in rows] == [0.5, 1.0, 0.95]
    assert [row.get("confirmation/success_rate") for row in rows] == [None, 0.8, 0.9]


def test_an_incomplete_evaluation_meets_no_criterion(monkeypatch: pytest.MonkeyPatch) -> None:
    overrides = [*LINE_TASK, far(6), "evaluation.criterion=0.5", "evaluation.every_samples=0", "evaluation.gate=0", "budget.samples=16"]  # fmt: skip
    training = make_training(line_plugins(), overrides)
    monkeypatch.setattr(
        training.job, "evaluate", lambda *a, **k: Evaluation(4, "", 1.0, complete=False)
    )
    rows = list(training.rows())
    assert training.outcome == "budget"
    assert not any("evaluation/success_rate" in row for row in rows)
    assert all(row["evaluation/success_rate_at_most"] == 1.0 for row in rows)


def test_judging_is_on_a_draw_of_its_own() -> None:
    training = make_training(line_plugins(), [*DRAWN, "evaluation.final_episodes=6"])
    found, recording = training.judge()
    assert (found.episodes, recording) == (6, None)
    assert found == evaluator(task=DRAWN).run(training.job.policy, "final", 6)
