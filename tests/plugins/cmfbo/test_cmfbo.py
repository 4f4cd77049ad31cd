"""CMFBO: easy tasks first, hard ones near what was good at easy ones, policies handed on."""

from __future__ import annotations

import itertools
import time
from dataclasses import replace
from typing import Any

import pytest
import torch
from search_runs import Told, carry_on, fits_once, forget_fits, valley  # noqa: F401 - a fixture

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy_bayes import draws
from understudy_bayes.acquisition import beta, upper_bound
from understudy_bayes.book import Data
from understudy_bayes.space import Parameter
from understudy_bayes.starts import maximise
from understudy_bayes.surrogate import Surrogate, SurrogateOptions
from understudy_cmfbo.cmfbo import CMFBO
from understudy_sweeps.loops import Report, Trial

SPACE = {"a.x": Parameter(-1.0, 1.0), "learner.rate": Parameter(1e-4, 1e-1, "log")}


def make(seed: int = 0, **options: Any) -> CMFBO:
    given = {"parameters": SPACE, "trials": 14, "initial": 5, "epsilon": 0.05, **options}
    return CMFBO(CMFBO.Options(**given), seed)


def trials(told: Told) -> list[Trial]:
    return [event for event in told if isinstance(event, Trial)]


@pytest.fixture(scope="module")
def told() -> Told:
    return carry_on(make(), valley)


def test_easy_tasks_come_first(told: Told) -> None:
    fidelities = [t.fidelity for t in trials(told)]
    assert fidelities[:5] == [0.0] * 5
    assert 0.0 in fidelities[5:]
    assert 0.0 < (next(f for f in fidelities if f) or 0.0) <= 1.0
    assert 1.0 in fidelities


def test_hard_tasks_are_asked_only_where_easy_ones_were_good(told: Told) -> None:
    """The space that whole trials are in is a small part of what random search would cover."""
    whole = [t for t in trials(told) if t.fidelity == 1.0]
    assert all(abs(t.point["a.x"] - 0.3) < 0.35 for t in whole)


def test_it_finds_the_optimum(told: Told) -> None:
    loop = make()
    carry_on(loop, valley, told)
    rows = loop.summary()
    answer = next(row for row in rows if row["found"] == "answer")
    highest = next(row for row in rows if row["found"] == "highest y")
    assert answer["fidelity"] == 1.0
    assert answer["y"] > -0.02
    assert highest["fidelity"] < 1.0
    assert highest["y"] > answer["y"]
    assert rows[-1]["best"] == answer["y"]


def test_harder_tasks_are_asked_close_to_what_was_good() -> None:
    """In the last trials close to an earlier trial; on the way up to where algorithm 3 began, in
    however many steps of z."""
    loop = make(close=0.05, trials=16)
    told = carry_on(loop, valley)
    space, seen = loop._book.space, torch.empty(0, 2)
    for trial in trials(told):
        x = torch.tensor([space.unit(trial.point)])
        if trial.fidelity == 1.0 and len(seen) >= 12:
            assert (x - seen).abs().amax(dim=1).min() < 0.05 + 1e-4
        seen = torch.cat([seen, x])
    data, options = loop._book.data(), SurrogateOptions(fidelity_scale=0.1)
    model = Surrogate(options, data, space=space)
    bound = upper_bound(model, beta(2, 17), 0.0, of=1.0)
    begin = maximise(bound, loop._book, 0, 16)
    loop._options = replace(loop._options, epsilon=100.0)
    x, z = loop._progress(model, 16)
    assert z == 1.0
    assert model.fidelity_scale < 0.5  # several steps
    assert 0 < (x - begin).abs().max() <= 0.05 + 1e-9


def steps(trial: Trial) -> float:
    """Highest at a = 3, b = 1; easier tasks have lower values."""
    a, b = trial.point["a"], trial.point["b"]
    return -((a - 3) ** 2) - 0.3 * (b - 1) ** 2 + 0.1 * (trial.fidelity or 0.0)


def test_small_integers_are_not_asked_for_again_and_again() -> None:
    """What is known of the point that would be trained counts, not of a place between two of them."""
    space = {"a": Parameter(1, 3, integer=True), "b": Parameter(1, 3, integer=True)}
    told = carry_on(make(parameters=space, trials=12, initial=4, reserve=0.0), steps)
    asked = [(t.point["a"], t.point["b"], t.fidelity) for t in trials(told)]
    assert all(asked.count(one) <= 2 for one in asked if one[2] == 0.0)
    assert (3, 1, 1.0) in asked


@pytest.mark.parametrize("cut", [3, 15, 20, 25])
def test_a_stopped_search_ends_with_the_same_trials(told: Told, cut: int) -> None:
    if cut == 3:
        forget_fits()
    assert carry_on(make(), valley, told[:cut]) == told


def test_policies_are_handed_on(told: Told) -> None:
    """From z_min upwards, each from an earlier finished trial of an easier task."""
    seen: dict[str, float] = {}
    for trial in trials(told):
        assert trial.fidelity is not None
        assert (trial.start is None) == (trial.fidelity == 0.0)
        if trial.start is not None:
            assert seen[trial.start["trial"]] < trial.fidelity
            assert trial.start["parts"] == ["actor", "critic", "normaliser"]
        seen[trial.key] = trial.fidelity


def test_as_printed_a_whole_trial_may_begin_from_a_whole_one() -> None:
    told = trials(carry_on(make(epsilon=10.0, trials=12, easier=False), valley))
    whole = [t.key for t in told if t.fidelity == 1.0]
    assert any((t.start or {}).get("trial") in whole for t in told)


def test_the_nearest_trial_is_the_most_correlated_one() -> None:
    """k((x, z), (x_i, z_i)) decides, not how good the trial was; failed ones have no policy."""
    loop = make()
    for number, (x, y) in enumerate([(-0.9, 5.0), (0.32, 0.0), (0.3, 0.1), (0.8, 1.0)]):
        trial = Trial(f"trial{number}", point={"a.x": x, "learner.rate": 1e-2}, fidelity=0.5)
        loop.recall(trial)
        loop.tell(Report(trial.key, "ok" if number != 2 else "failed: fell", y, cost=1.0))
    running = Trial("trial4", point={"a.x": 0.3, "learner.rate": 1e-2}, fidelity=0.5)
    loop.recall(running)
    x = torch.linspace(0, 1, 8, dtype=torch.float64).unsqueeze(1).expand(8, 2)
    model = Surrogate(SurrogateOptions(), Data(x, x[:, 0], torch.sin(9 * x[:, 0]), x[:, 0]))
    here = torch.tensor([0.65, 2 / 3]).double()
    found = loop._nearest(model, here, 0.6)
    assert found == {"trial": "trial1", "parts": ["actor", "critic", "normaliser"]}
    assert loop._nearest(model, here, 0.5) is None
    assert loop._nearest(model, here, 0.0) is None


def test_without_transfer_every_trial_begins_anew() -> None:
    told = carry_on(make(transfer=False, epsilon=10.0, trials=8), valley)
    assert trials(told)[-1].fidelity == 1.0
    assert all(t.start is None for t in trials(told))


def test_what_is_transferred_is_an_option() -> None:
    told = carry_on(make(parts=("actor",), epsilon=10.0, trials=6), valley)
    assert (trials(told)[-1].start or {})["parts"] == ["actor"]


@pytest.mark.parametrize(("epsilon", "expected"), [(1e-9, 0.0), (1e9, 1.0)])
def test_epsilon_decides_when_a_task_is_known_well_enough(epsilon: float, expected: float) -> None:
    told = carry_on(make(epsilon=epsilon, trials=8, reserve=0.0), valley)
    assert [t.fidelity for t in trials(told)[5:]] == [expected] * 3


@pytest.mark.parametrize("limit", [{"trials": 12}, {"trials": None, "budget": 200.0}])
def test_what_is_left_in_the_end_is_for_the_task_itself(limit: dict[str, Any]) -> None:
    """However little is known at z_min, so that a search does not end without an answer."""
    loop = make(epsilon=1e-9, reserve=0.25, **limit)
    fidelities = [t.fidelity for t in trials(carry_on(loop, valley))]
    whole = fidelities.count(1.0)
    assert whole > 0
    assert fidelities == [0.0] * (len(fidelities) - whole) + [1.0] * whole
    rows = loop.summary()
    spent = [0.0, *itertools.accumulate(row["samples"] for row in rows)]
    for number, fidelity in enumerate(fidelities):
        share = number / 12 if "budget" not in limit else spent[number] / 200
        assert (fidelity == 1.0) == (share >= 0.75)
    assert sum(row["found"] == "answer" for row in rows) == 1


def test_the_last_trials_begin_where_easy_ones_were_good() -> None:
    """Five whole trials suffice after a search that never got past z_min."""
    loop = make(epsilon=1e-9, trials=14, reserve=5 / 14)
    carry_on(loop, valley)
    answer = next(row for row in loop.summary() if row["found"] == "answer")
    assert answer["y"] > -0.1


def test_a_search_that_ends_before_the_task_itself_says_so() -> None:
    loop = make(epsilon=1e-9, trials=7, reserve=0.0)
    carry_on(loop, valley)
    marks = [row["found"] for row in loop.summary() if row["found"]]
    assert marks == ["highest y; no trial at full fidelity, so no answer"]


def test_the_step_is_the_fidelitys_length_scale() -> None:
    """α = l_z: with one that is short, whatever is known at z_min is asked next at z_min + l_z."""
    short = SurrogateOptions(fidelity_scale=0.3, fidelity_spread=1e-3)
    told = carry_on(make(surrogate=short, epsilon=0.2, trials=10), valley)
    above = [t.fidelity for t in trials(told) if t.fidelity]
    assert above
    assert all(
        f == pytest.approx(min(0.3 * round(f / 0.3), 1.0), abs=0.01) or f == 1.0 for f in above
    )


def test_what_is_chosen_of_the_model_leaves_the_rest() -> None:
    """A kernel alone keeps this search's prior on l_z and its mean."""
    given = {"parameters": {"a.x": {"low": 0.0, "high": 1.0}}, "trials": 3}
    for surrogate, expected in [({"kernel": "matern"}, (1.0, 1.0)), ({"slope": 0.0}, (1.0, 0.0))]:
        options = make_options(CMFBO.Options, {**given, "surrogate": surrogate}, "o")
        found = CMFBO(options)._surrogate
        assert (found.fidelity_scale, found.slope) == expected


def test_difficulty_from_and_to() -> None:
    given = {
        "parameters": {"a.x": {"low": -1.0, "high": 1.0}},
        "trials": 8,
        "initial": 5,
        "epsilon": 1e9,
    }
    options = make_options(CMFBO.Options, {**given, "fidelity": {"low": 0.2, "high": 0.8}}, "o")
    fidelities = {t.fidelity for t in trials(carry_on(CMFBO(options, 0), valley))}
    assert fidelities <= {0.2, 0.8}


def test_a_total_of_samples_ends_it() -> None:
    """N_total of algorithm 4; the trial that reaches it is the last."""
    told = carry_on(make(trials=None, budget=400.0), valley)
    costs = [event.cost for event in told if isinstance(event, Report)]
    assert sum(costs[:-1]) < 400 <= sum(costs)


@pytest.mark.parametrize("objective", [None, float("nan"), 2.0])
def test_it_goes_on_when_nothing_is_learned(objective: float | None) -> None:
    assert len(trials(carry_on(make(trials=9), lambda trial: objective))) == 9


def test_errors_name_the_option() -> None:
    good = {"parameters": {"a.x": {"low": 0.0, "high": 1.0}}, "trials": 3}
    for bad, message in [
        ({"epsilon": 0.0}, r"o\.epsilon=0\.0 is not possible"),
        ({"reserve": 1.5}, r"o\.reserve=1\.5 is not possible"),
        ({"surrogate": {"slope": -1.0}}, r"o\.surrogate\.slope=-1\.0 is not possible"),
        ({"parts": []}, "parts must not be empty"),
        ({"parts": ["legs"]}, "'legs' is not possible"),
        ({"fidelity": {"high": 1.5}}, r"o\.fidelity\.high|o\.fidelity\.low"),
        ({"trials": None}, "say when the search ends"),
        ({"parameters": {"a.x": {"low": 1.0, "high": 0.0}}}, r"o\.parameters\.a\.x\.low=1"),
    ]:
        with pytest.raises(ConfigError, match=message):
            make_options(CMFBO.Options, {**good, **bad}, "o")


def test_an_ask_takes_seconds() -> None:
    """With 60 trials of 12 parameters, of one core; 0.4 s where this was written."""
    space = {f"a.x{i}": Parameter(0.0, 1.0) for i in range(12)}
    loop = CMFBO(CMFBO.Options(parameters=space, trials=99), 0)
    for number in range(60):
        u = draws.spread(1, number, 12)
        point = dict(zip(space, u, strict=True))
        loop.recall(Trial(f"trial{number}", point=point, fidelity=float(number % 2)))
        y = -sum((v - 0.6) ** 2 for v in u) + 0.02 * (number % 5)
        loop.tell(Report(f"trial{number}", "ok", y, cost=1.0))
    began = time.process_time()
    assert loop.ask(60) is not None
    assert time.process_time() - began < 10


def test_the_last_trials_try_the_most_promising_place_before_they_move_from_it() -> None:
    """An easy trial's place is asked about at z_max as it is, and only then are points beside it."""
    told = carry_on(make(epsilon=1e-9, trials=8, reserve=0.375), valley)
    easy = [t.point for t in trials(told) if t.fidelity == 0.0]
    whole = [t.point for t in trials(told) if t.fidelity == 1.0]
    assert len(whole) == 3
    assert any(whole[0] == pytest.approx(point, rel=1e-6) for point in easy)
    assert not any(point == pytest.approx(whole[0], rel=1e-6) for point in whole[1:])


def test_epsilon_is_a_share_of_the_objectives_scale_where_that_is_known() -> None:
    """Of a ceiling of 1 (eq. 6.5), not of the little that the first trials differ by."""
    scaled = {"epsilon": 0.02, "trials": 9, "reserve": 0.0, "noise": 0.0, "sample_scale": 1e9}
    little = lambda trial: 0.05 * valley(trial)  # noqa: E731
    without = trials(carry_on(make(**scaled), little))
    with_it = trials(carry_on(make(**scaled, ceiling=1.0), little))
    assert max(t.fidelity or 0.0 for t in with_it) > max(t.fidelity or 0.0 for t in without)
