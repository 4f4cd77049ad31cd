"""Random search, GP-UCB and BOCA: what they ask for, and that a search can be stopped anywhere."""

from __future__ import annotations

import dataclasses
import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from search_runs import Told, carry_on, fits_once, forget_fits, valley  # noqa: F401 - a fixture
from worlds import python

from understudy.errors import ConfigError, PluginError
from understudy.options import make_options
from understudy.setup.plugins import installed
from understudy_bayes.boca import BOCA, cheapest, relative_cost
from understudy_bayes.book import Data
from understudy_bayes.fidelity import Fidelity
from understudy_bayes.gp_ucb import GPUCB
from understudy_bayes.random_search import RandomSearch
from understudy_bayes.space import Parameter
from understudy_bayes.surrogate import Surrogate, SurrogateOptions
from understudy_sweeps.loops import OuterLoop, Report

SPACE = {
    "a.x": Parameter(-1.0, 1.0),
    "learner.rate": Parameter(1e-4, 1e-1, "log"),
    "learner.epochs": Parameter(1, 9, integer=True),
}
LOOPS: list[Any] = [RandomSearch, GPUCB, BOCA]


def make(kind: Any, seed: int = 0, **options: Any) -> OuterLoop:
    given = {"parameters": SPACE, "trials": 9, "initial": 5, **options}
    return kind(kind.Options(**given), seed)


@pytest.fixture(scope="module", params=LOOPS, ids=lambda kind: kind.__name__)
def done(request: pytest.FixtureRequest) -> tuple[Any, Told]:
    return request.param, carry_on(make(request.param), valley)


def test_it_asks_as_often_as_told(done: tuple[Any, Told]) -> None:
    trials = [event for event in done[1] if not isinstance(event, Report)]
    assert [t.key for t in trials] == [f"trial{i}" for i in range(9)]
    for trial in trials:
        assert set(trial.point) == set(SPACE)
        assert all(p.low <= trial.point[name] <= p.high for name, p in SPACE.items())
        assert type(trial.point["learner.epochs"]) is int


@pytest.mark.parametrize("cut", [1, 10, 13, 16])
def test_a_stopped_search_ends_with_the_same_trials(done: tuple[Any, Told], cut: int) -> None:
    """As after a kill between any two rows of the journal."""
    kind, told = done
    if cut == 1:
        forget_fits()
    assert carry_on(make(kind), valley, told[:cut]) == told


def test_another_seed_is_another_search(done: tuple[Any, Told]) -> None:
    first = make(done[0], seed=1).ask(0)
    assert first is not None
    assert first.point != done[1][0].point  # type: ignore[union-attr]


def test_workers_get_different_trials() -> None:
    """Five at once, none of them finished, are five places; all but the first few are a model's."""
    loop = make(GPUCB, trials=20)
    told = carry_on(loop, valley, upto=6)
    more = [loop.ask(number) for number in range(6, 11)]
    points = torch.tensor([[t.point["a.x"], t.point["learner.epochs"] / 9] for t in more if t])
    assert len(points) == 5
    assert torch.pdist(points).min() > 1e-2
    again = make(GPUCB, trials=20)
    carry_on(again, valley, told, upto=6)
    for trial in more[:3]:
        assert trial is not None
        assert again.recall(trial)
    assert [again.ask(number) for number in (9, 10)] == more[3:]


def test_a_model_waits_for_the_first_report() -> None:
    loop = make(GPUCB, initial=2)
    assert [loop.ask(number) is None for number in range(3)] == [False, False, True]
    loop.tell(Report("trial1", "ok", 0.5))
    assert loop.ask(2) is not None


@pytest.mark.parametrize("kind", LOOPS[1:])
def test_a_model_finds_what_chance_does_not(kind: Any) -> None:
    found = [
        max(row["best"] or -9 for row in loop.summary())
        for loop in (make(kind, trials=13), make(RandomSearch, trials=13))
        if carry_on(loop, valley)
    ]
    assert found[0] > -0.02
    assert found[0] > found[1]


@pytest.mark.parametrize("kind", LOOPS)
@pytest.mark.parametrize("objective", [None, float("nan"), 3.0])
def test_searches_go_on_when_nothing_is_learned(kind: Any, objective: float | None) -> None:
    loop = make(kind, trials=8)
    told = carry_on(loop, lambda trial: objective)
    assert len(told) == 16


# ---------------------------------------------------------------------------------- BOCA


def model(slope: float) -> Surrogate:
    """Of a function that changes by `slope` from z = 0 to 1, seen at both."""
    x = torch.linspace(0, 1, 9, dtype=torch.float64).repeat(2).unsqueeze(1)
    z = torch.arange(18).div(9, rounding_mode="floor").double()
    y = torch.sin(6 * x[:, 0]) + slope * z * torch.cos(20 * x[:, 0])
    return Surrogate(SurrogateOptions(), Data(x, z, y, torch.ones_like(z)))


Z = torch.arange(100, dtype=torch.float64) / 100


def test_what_is_known_is_asked_at_full_fidelity() -> None:
    here = torch.tensor([0.5]).double()
    assert cheapest(model(0.0), here, Z, 0.1 + 0.9 * Z, weight=4.0) == 1.0


def test_what_is_unknown_is_asked_cheaply() -> None:
    """The cheapest fidelity at which the doubt is above γ(z), computed here by hand."""
    found, x = model(2.0), torch.tensor([0.55]).double()
    relative = 0.01 + 0.99 * Z
    z = cheapest(found, x, Z, relative, weight=9.0)
    with torch.no_grad():
        _, doubt = found.posterior(x.expand(100, -1), Z)
    gap = (1 - torch.exp(-0.5 * ((1 - Z) / found.fidelity_scale) ** 2) ** 2).sqrt()
    allowed = (doubt > gap * relative ** (1 / 4)) & (gap > gap.max() / 3)
    assert allowed.any()
    assert z == Z[allowed][0]
    assert z < 1


def test_when_all_fidelities_cost_the_same_the_whole_trial_is_best() -> None:
    x = torch.tensor([0.55]).double()
    assert cheapest(model(2.0), x, Z, torch.ones(100, dtype=torch.float64), weight=9.0) == 1.0


def test_costs_are_learned() -> None:
    z = torch.tensor([0.0, 0.2, 0.5, 1.0]).double()
    data = Data(z.unsqueeze(1), z, z, 100 * torch.exp(2 * z))
    assert relative_cost(z, data, None) == pytest.approx(torch.exp(2 * (z - 1)))
    assert relative_cost(z, data, 0.1) == pytest.approx(0.1 + 0.9 * z)
    free = Data(z.unsqueeze(1), z, z, torch.zeros(4))
    assert relative_cost(z, free, None) == pytest.approx(0.25 + 0.75 * z)
    dearer = Data(z.unsqueeze(1), z, z, torch.exp(-z))
    assert relative_cost(z, dearer, None) == pytest.approx(torch.ones(4).double())


def test_iterations_are_written_as_a_budget() -> None:
    fidelity = {"option": "budget.samples", "low": 1e5, "high": 1e6, "integer": True}
    given = {"parameters": {"a.x": {"low": -1.0, "high": 1.0}}, "trials": 9, "initial": 4}
    options = make_options(BOCA.Options, {**given, "fidelity": fidelity}, "outer_loop")
    trials = [t for t in carry_on(BOCA(options, 0), valley) if not isinstance(t, Report)]
    samples = [t.point["budget.samples"] for t in trials]
    assert all(t.fidelity is None for t in trials)
    assert all(type(n) is int and 1e5 <= n <= 1e6 for n in samples)
    assert len(set(samples)) > 1


def test_registering_imports_no_heavy_library(tmp_path: Path) -> None:
    done = python(
        "import sys, understudy_bayes, understudy_cmfbo; from understudy.setup.plugins import installed;"
        "found = installed().registry; assert found.names('outer_loop');"
        "print(sorted({'torch', 'botorch', 'gpytorch'} & set(sys.modules)))",
        cwd=tmp_path,
    )
    assert done.stdout.strip() == "[]", done.stderr


def test_without_botorch_one_sentence(monkeypatch: pytest.MonkeyPatch) -> None:
    for name in [n for n in sys.modules if n.startswith(("understudy_bayes", "botorch"))]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, "botorch", None)  # import botorch now fails
    registry = installed().registry
    component = dataclasses.replace(registry.find("outer_loop", "gp_ucb"))
    with pytest.raises(PluginError, match=r"pip install 'understudy\[bayes\]'"):
        _ = component.factory
    assert dataclasses.replace(registry.find("outer_loop", "random_search")).factory


def test_ranges_are_told_before_the_first_trial() -> None:
    """As the configuration is given them: whole numbers whole, and a budget by which trials are cheap."""
    space = {"a.x": (-1.0, 1.0), "learner.rate": (1e-4, 1e-1), "learner.epochs": (1, 9)}
    assert make(RandomSearch).ranges == make(GPUCB).ranges == make(BOCA).ranges == space
    assert all(type(end) is int for end in make(GPUCB).ranges["learner.epochs"])
    cheap = Fidelity("budget.samples", 1e6, 3e6, integer=True)
    assert make(BOCA, fidelity=cheap).ranges == space | {"budget.samples": (1_000_000, 3_000_000)}


def test_errors_name_the_option() -> None:
    range_ = {"low": 0.0, "high": 1.0, "scale": "log"}
    with pytest.raises(ConfigError, match=r"outer_loop\.parameters\.a\.x\.low=0 is not possible"):
        make_options(GPUCB.Options, {"parameters": {"a.x": range_}, "trials": 3}, "outer_loop")
