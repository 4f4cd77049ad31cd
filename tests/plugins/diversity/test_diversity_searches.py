"""What diversity searches ask for, how they tell strategies apart, and that they can be stopped anywhere."""

from __future__ import annotations

import dataclasses
import json
import math
import time
from pathlib import Path
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from landscapes import OPTIONS, Told, carry_on, make, stairs, strategy

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy.task import Context
from understudy_bayes.space import Parameter
from understudy_diversity.acquisition import by_direct, by_gradient, expected_novelty, uncertainty
from understudy_diversity.map_elites import MapElites
from understudy_diversity.novel_policies import NovelPolicies
from understudy_diversity.novelty import Novelty
from understudy_diversity.search import DiversitySearch, RandomDiversity
from understudy_diversity.strategies import Feature, alike, distances, feature_of
from understudy_diversity.surrogate import Surrogate
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_tensors import rotations

LOOPS: list[Any] = [DiversitySearch, RandomDiversity, MapElites]


def points(told: Told) -> list[tuple[float, ...]]:
    return [tuple(e.point.values()) for e in told if isinstance(e, Trial)]


def different(told: Told) -> int:
    return len({strategy(x, y) for x, y in points(told)})


@pytest.fixture(scope="module", params=LOOPS, ids=lambda kind: kind.__name__)
def done(request: pytest.FixtureRequest) -> tuple[Any, Told]:
    return request.param, carry_on(make(request.param))


def test_it_asks_as_often_as_told(done: tuple[Any, Told]) -> None:
    trials = [event for event in done[1] if isinstance(event, Trial)]
    assert [t.key for t in trials] == [f"trial{i}" for i in range(8)]
    assert all(0 <= value <= 1 for point in points(done[1]) for value in point)


@pytest.mark.parametrize("kind", LOOPS)
def test_ranges_are_told_before_the_first_trial(kind: Any) -> None:
    assert make(kind).ranges == {"a.x": (0.0, 1.0), "a.y": (0.0, 1.0)}


@pytest.mark.parametrize("cut", [1, 6, 9, 14])
def test_a_stopped_search_ends_with_the_same_trials(done: tuple[Any, Told], cut: int) -> None:
    """As after a kill between any two rows of the journal."""
    kind, told = done
    assert carry_on(make(kind), told=told[:cut]) == told


def test_another_seed_is_another_search(done: tuple[Any, Told]) -> None:
    first = make(done[0], seed=1).ask(0)
    assert first is not None
    assert first.point != done[1][0].point  # type: ignore[union-attr]


def test_the_summary_counts_different_strategies(done: tuple[Any, Told]) -> None:
    loop = make(done[0])
    told = carry_on(loop)
    rows = loop.summary()
    assert [row["trial"] for row in rows] == [f"trial{i}" for i in range(8)]
    assert rows[-1]["different"] == different(told)
    assert loop.share == 1.0


def test_it_finds_more_strategies_than_chance() -> None:
    """In eight trials on a square most of which is two of six strategies, over five seeds."""
    found = [
        sum(different(carry_on(make(kind, seed))) for seed in range(5))
        for kind in (DiversitySearch, RandomDiversity)
    ]
    assert found[0] >= found[1] + 4


def test_exploration_and_exploitation_alternate(monkeypatch: pytest.MonkeyPatch) -> None:
    """Algorithm 1: N_exp trials by L-BFGS, then N_opt by DIRECT, and again."""
    from understudy_diversity import search

    used = []
    monkeypatch.setattr(search, "by_gradient", lambda *a: used.append("explore") or by_gradient(*a))
    monkeypatch.setattr(search, "by_direct", lambda *a: used.append("exploit") or by_direct(*a))
    carry_on(make(DiversitySearch, explore=2, exploit=1, trials=8, initial=2))
    assert used == ["explore", "explore", "exploit"] * 2


def test_an_ask_takes_less_than_ten_seconds() -> None:
    """With as many trials as six searches of the thesis have."""
    loop = make(DiversitySearch, trials=200, explore=0)
    for number in range(60):
        x, y = torch.rand(2, generator=torch.Generator().manual_seed(number)).tolist()
        trial = Trial(f"trial{number}", point={"a.x": x, "a.y": y})
        loop.recall(trial)
        loop.tell(Report(trial.key, "ok", 0.0, stairs(trial), 10.0))
    began = time.process_time()
    assert loop.ask(60) is not None
    assert time.process_time() - began < 10


def test_workers_get_different_trials() -> None:
    loop = make(DiversitySearch, trials=20, explore=1, exploit=1)
    for number in range(3):
        trial = loop.ask(number)
        assert trial is not None
        loop.tell(Report(trial.key, "ok", 0.0, stairs(trial), 10.0))
    more = [loop.ask(number) for number in range(3, 7)]
    where = torch.tensor([list(t.point.values()) for t in more if t])
    assert torch.pdist(where).min() > 1e-2


def test_failed_trials_show_nothing_and_are_not_repeated() -> None:
    def half(trial: Trial) -> dict[str, float]:
        return {**stairs(trial), "success_rate": float(trial.point["a.x"] > 0.5)}

    loop = make(DiversitySearch, trials=10)
    told = carry_on(loop, half)
    rows = loop.summary()
    assert any(row["success"] == 0.0 for row in rows)
    assert all((row["strategy"] is None) == (row["success"] == 0.0) for row in rows)
    assert torch.pdist(torch.tensor(points(told))).min() > 1e-3


def test_a_trial_that_makes_no_progress_is_ended_early() -> None:
    """By any search, and again when what was told is told once more."""
    for kind in LOOPS:
        loops = [make(kind, stalled={"figure": "bar", "samples": 3.0}) for _ in range(2)]
        trial = loops[0].ask(0)
        assert trial is not None
        assert loops[1].recall(trial)
        figures = [0.1, 0.2, 0.2, 0.3, 0.3, 0.1, 0.3, 0.9]
        for loop in loops:
            answers = [
                loop.tell(Report(trial.key, "running", None, {"bar": value}, float(cost)))
                for cost, value in enumerate(figures)
            ]
            assert answers == [None] * 6 + ["stop", None]
        told = Report(trial.key, "running", None, {"bars": 0.0}, 9.0)
        with pytest.raises(ConfigError, match=r"stalled\.figure names 'bar', .* 'bars'"):
            loops[0].tell(told)


def test_a_trial_whose_bar_is_at_its_target_goes_on() -> None:
    """It cannot rise any more, though the trial may still improve."""
    loop = make(RandomDiversity, stalled={"figure": "bar", "samples": 2.0, "until": 0.5})
    trial = loop.ask(0)
    assert trial is not None

    def told(key: str, bars: list[float]) -> list[str | None]:
        return [
            loop.tell(Report(key, "running", None, {"bar": bar}, float(cost)))
            for cost, bar in enumerate(bars)
        ]

    assert told(trial.key, [0.4, 0.5, 0.5, 0.5, 0.3, 0.5]) == [None] * 6
    assert told("lower", [0.4, 0.4, 0.4, 0.4]) == [None, None, "stop", "stop"]


def test_a_search_that_only_fails_goes_on() -> None:
    told = carry_on(make(DiversitySearch), lambda trial: {"angle": 0.0, "success_rate": 0.0})
    assert len(set(points(told))) == 8


def test_a_feature_that_is_not_measured_is_one_sentence() -> None:
    loop = make(DiversitySearch)
    trial = loop.ask(0)
    assert trial is not None
    with pytest.raises(ConfigError, match=r"'angle' is no measure of trial 'trial0'.*'angel'"):
        loop.tell(Report(trial.key, "ok", 0.0, {"angel": 1.0}, 10.0))


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"features": {}}, "features must not be empty"),
        ({"metric": "rotation"}, "has 1 measures: metric=rotation takes six"),
        ({"distinct": 0.0}, "distinct=0.0 is not possible"),
        ({"explore": 0, "exploit": 0}, "explore=0 is not possible with exploit=0"),
        ({"features": {"angle": {"low": 1.0, "high": 1.0}}}, "low=1 is not possible"),
    ],
)
def test_options_that_cannot_be_are_one_sentence(change: dict[str, Any], sentence: str) -> None:
    with pytest.raises(ConfigError, match=sentence):
        make(DiversitySearch, **change)


# ---------------------------------------------------------------- what strategies are


def test_alike_are_those_near_to_all_others_of_their_kind() -> None:
    """A chain in which each is near to the next is not one strategy."""
    chain = torch.tensor([[0.0], [0.7], [1.4], [5.0], [0.1]], dtype=torch.float64)
    groups = alike(chain, 1.0, "euclidean")
    assert groups[0] == groups[4] == 0
    assert groups[3] == max(groups)
    assert groups[0] != groups[2]
    assert alike(chain[:1], 1.0, "euclidean") == [0]
    assert alike(chain[:0], 1.0, "euclidean") == []
    assert alike(torch.tensor([[0.0], [1.0]], dtype=torch.float64), 1.0, "euclidean") == [0, 1]


seeds = st.integers(0, 2**32 - 1)


def drawn(seed: int, count: int) -> torch.Tensor:
    """Quaternions (count, 4) of rotations drawn uniformly."""
    stream = torch.Generator().manual_seed(seed)
    return rotations.normalize(torch.randn(count, 4, generator=stream))


def turned(q: torch.Tensor, axis: torch.Tensor, angle: float | torch.Tensor) -> torch.Tensor:
    return rotations.multiply(q, rotations.from_axis_angle(axis, torch.as_tensor(angle)))


@settings(max_examples=50, deadline=None)
@given(seeds, st.floats(0.0, math.pi))
def test_rotations_are_apart_by_their_angle(seed: int, angle: float) -> None:
    q, axis = drawn(seed, 1), rotations.normalize(drawn(seed + 1, 1)[:, 1:])
    a, b = (rotations.tangent_normal(p) for p in (q, turned(q, axis, angle)))
    assert distances(a, a, "rotation").item() == 0.0
    assert distances(a, b, "rotation").item() == pytest.approx(angle, abs=2e-3)


@settings(max_examples=20, deadline=None)
@given(seeds)
def test_axes_are_completed_to_rotations(seed: int) -> None:
    """Of any length, and the z axis with any part along the x axis."""
    axes = rotations.tangent_normal(drawn(seed, 8)).double()
    x, z = axes.split(3, dim=-1)
    skewed = torch.cat([2.0 * x, 0.3 * z + 0.7 * x], dim=-1)
    assert distances(skewed, axes, "rotation").diagonal().max() < 1e-6


@settings(max_examples=50, deadline=None)
@given(seeds)
def test_the_mean_of_attempts_near_half_a_turn_is_near_to_them(seed: int) -> None:
    """512 rotations by 0.99 π about any axis, with a noise of 0.15 rad about each axis."""
    axis = rotations.normalize(drawn(seed, 1)[:, 1:])
    q = turned(torch.tensor([[1.0, 0.0, 0.0, 0.0]]), axis, 0.99 * math.pi)
    noise = 0.15 * torch.randn(512, 3, generator=torch.Generator().manual_seed(seed))
    seen = rotations.tangent_normal(rotations.multiply(q, rotations.from_exponential_map(noise)))
    found = shown_rotation(seen.mean(0).tolist())
    assert found is not None
    f = torch.tensor([found])
    assert distances(f, rotations.tangent_normal(q), "rotation").item() < 0.05
    assert torch.allclose(f.view(2, 3) @ f.view(2, 3).T, torch.eye(2), atol=1e-5)


def shown_rotation(means: list[float]) -> tuple[float, ...] | None:
    """The feature of a trial that measured these axes."""
    options = DiversitySearch.Options(**rotation_options())
    measures = {**dict(zip(AXES, means, strict=True)), "success_rate": 1.0}
    return feature_of(Report("trial0", "ok", 1.0, measures), options)


AXES = [f"{axis}{k}" for axis in "xz" for k in range(3)]


def rotation_options() -> dict[str, Any]:
    return {
        "parameters": {"a.x": Parameter(0.0, 1.0)},
        "features": {name: Feature(-1.0, 1.0) for name in AXES},
        "distinct": 0.5,
        "trials": 6,
        "metric": "rotation",
    }


def test_axes_that_cancel_out_are_no_rotation() -> None:
    assert shown_rotation([0.0] * 6) is None
    assert shown_rotation([1.0, 0.0, 0.0, 0.5, 0.0, 0.0]) is None
    assert shown_rotation([1.0, 0.0, math.nan, 0.0, 0.0, 1.0]) is None
    assert shown_rotation([1.0, 0.0, 1e300, 0.0, 0.0, 1.0]) is None


def test_a_search_of_rotations_finds_them() -> None:
    """On both sides of half a turn about z."""

    def shown(trial: Trial) -> dict[str, float]:
        q = rotations.from_heading(
            torch.tensor(math.pi + math.copysign(0.5, trial.point["a.x"] - 0.5))
        )
        axes = (0.9 * rotations.tangent_normal(q)).tolist()
        return {**dict(zip(AXES, axes, strict=True)), "success_rate": 1.0}

    loop = DiversitySearch(DiversitySearch.Options(**rotation_options()))
    carry_on(loop, shown)
    assert loop.summary()[-1]["different"] == 2


# ---------------------------------------------------------------- the model


@pytest.fixture(scope="module")
def model() -> Surrogate:
    x = torch.linspace(0.1, 0.6, 6, dtype=torch.float64)[:, None]
    return Surrogate(x, torch.sin(3 * x), [Feature(-2.0, 2.0)], seed=0)


def test_the_surrogate_knows_what_it_was_told_and_doubts_the_rest(model: Surrogate) -> None:
    with torch.no_grad():
        mean, deviation = model.posterior(torch.tensor([[0.25], [1.0]], dtype=torch.float64))
    assert mean[0].item() == pytest.approx(math.sin(0.75), abs=0.1)
    assert deviation[1] > 2 * deviation[0]


@pytest.mark.parametrize("features", [1, 3])
def test_its_posterior_is_the_librarys(features: int) -> None:
    stream = torch.Generator().manual_seed(features)
    x = torch.rand(9, 2, dtype=torch.float64, generator=stream)
    f = torch.randn(9, features, dtype=torch.float64, generator=stream)
    model = Surrogate(x, f, [Feature(-1.0, 1.0)] * features, seed=0)
    at = torch.rand(20, 2, dtype=torch.float64, generator=stream)
    model.model.eval()
    with torch.no_grad():
        expected = model.model.posterior(at)
        mean, deviation = model.posterior(at)
    assert torch.allclose(mean, expected.mean, atol=1e-5)
    assert torch.allclose(deviation, expected.variance.sqrt(), atol=1e-4)


def test_what_it_believes_changes_no_expectation_but_doubts_less() -> None:
    x = torch.tensor([[0.1], [0.5]], dtype=torch.float64)
    model = Surrogate(x, x, [Feature(0.0, 1.0)], seed=0)
    at = torch.tensor([[0.9]], dtype=torch.float64)
    mean, deviation = model.posterior(at)
    assert torch.equal(model.believe(at), mean)
    again, less = model.posterior(at)
    assert torch.allclose(again, mean, atol=1e-6)
    assert less < 0.5 * deviation


def test_far_away_it_expects_the_middle_of_the_range() -> None:
    """The prior mean (section 4.6.1), of two features at once."""
    x = torch.tensor([[0.0, 0.0], [0.02, 0.0]], dtype=torch.float64)
    f = torch.tensor([[3.0, -1.0], [3.0, -1.0]], dtype=torch.float64)
    found = Surrogate(x, f, [Feature(0.0, 4.0), Feature(-1.0, 1.0)], seed=0)
    with torch.no_grad():
        mean, _ = found.posterior(torch.tensor([[0.0, 0.0], [40.0, 40.0]], dtype=torch.float64))
    assert torch.allclose(mean[1], torch.tensor([2.0, 0.0], dtype=torch.float64), atol=1e-3)
    assert (mean[0] - f[0]).abs().max() < 0.5


def test_expected_novelty_is_equation_4_6(model: Surrogate) -> None:
    """Of one feature that was found, the mean of a folded normal distribution."""
    x = torch.tensor([[0.3], [0.9]], dtype=torch.float64)
    found = torch.tensor([[0.4]], dtype=torch.float64)
    with torch.no_grad():
        value = expected_novelty(model, found, "euclidean", 0, 7)(x)
        mean, deviation = model.posterior(x)
    z = (mean - 0.4) / deviation
    normal = torch.distributions.Normal(torch.zeros((), dtype=torch.float64), 1.0)
    exact = deviation * (2 * normal.log_prob(z).exp() + z * (2 * normal.cdf(z) - 1))
    assert torch.allclose(value, exact[:, 0], rtol=0.15)


def test_both_ways_find_where_a_function_is_highest(model: Surrogate) -> None:
    goal = torch.tensor([0.31, 0.77], dtype=torch.float64)

    def hill(x: torch.Tensor) -> torch.Tensor:
        return -(x - goal).square().sum(-1)

    assert torch.allclose(by_direct(hill, 2), goal, atol=0.01)
    assert torch.allclose(by_gradient(hill, 2, 0, 0), goal, atol=0.01)
    assert float(by_gradient(uncertainty(model), 1, 0, 0)) == pytest.approx(1.0)


# ---------------------------------------------------------------- stage 2


def test_novelty_is_equation_4_11() -> None:
    context = Context(0, torch.device("cpu"), 4, 0.1, 1)
    reward = Novelty(Novelty.Options(((0.0,), (2.0,)), threshold=1.0), context)
    found = reward(torch.tensor([0.0, 0.5, 1.0, 5.0]))
    assert torch.allclose(found, torch.tensor([0.01, 0.5, 1.0, 1.0]))
    upright = ((1.0, 0.0, 0.0, 0.0, 0.0, 1.0),)
    seen = Novelty(Novelty.Options(upright, metric="rotation"), context)
    q = rotations.from_axis_angle(torch.tensor([1.0, 0.0, 0.0]), torch.tensor([math.pi / 4]))
    assert seen(rotations.tangent_normal(q)).item() == pytest.approx(0.5, abs=1e-3)
    assert seen(torch.zeros(1, 6)).isfinite().all()  # of an episode that has none yet


def test_a_feature_of_other_numbers_is_one_sentence() -> None:
    context = Context(0, torch.device("cpu"), 4, 0.1, 1)
    reward = Novelty(Novelty.Options(((0.0, 1.0),)), context)
    with pytest.raises(ConfigError, match="the feature has 1 numbers and those in found have 2"):
        reward(torch.zeros(4))


@pytest.fixture
def searched(tmp_path: Path) -> Path:
    return searched_in(tmp_path)


def searched_in(folder: Path) -> Path:
    """A search that found two strategies, one of them twice, and failed once."""
    journal = Journal(folder / "journal.jsonl")
    for number, (angle, success) in enumerate([(0.5, 1.0), (2.5, 1.0), (0.6, 1.0), (1.5, 0.1)]):
        trial = Trial(f"trial{number}", point={"a.x": 0.1 * number, "a.y": 0.5})
        measures = {"angle": angle, "success_rate": success}
        journal.ask(trial)
        journal.tell(Report(trial.key, "ok", 0.0, measures, 10.0, str(folder / trial.key)))
    return folder


def novel(folder: Path, **options: Any) -> NovelPolicies:
    given = {
        "search": str(folder),
        "feature_field": "pose",
        "rounds": 2,
        "features": OPTIONS["features"],
        "distinct": 0.2,
        **options,
    }
    return NovelPolicies(make_options(NovelPolicies.Options, given, "outer_loop"), 0)


def test_novel_policies_begin_from_each_strategy(searched: Path) -> None:
    loop = novel(searched)
    first, second = loop.ask(0), loop.ask(1)
    assert first is not None
    assert second is not None
    assert first.start == {
        "run": str(searched / "trial0"),
        "parts": ["actor", "critic", "normaliser"],
    }
    assert second.point == {"a.x": 0.1, "a.y": 0.5}
    assert loop.ask(2) is None  # the first strategy's second round waits for its first
    override = first.overrides[-1]
    assert override.startswith(
        "++reward.terms.novelty={name:diversity/novelty,reads:{feature:pose}"
    )
    assert "found:[[0.5], [2.5], [0.6]]" in override


def test_novel_policies_avoid_what_was_found_before(searched: Path) -> None:
    loop = novel(searched)
    first = loop.ask(0)
    assert first is not None
    loop.tell(Report(first.key, "ok", 0.0, {"angle": 1.2, "success_rate": 1.0}, 10.0))
    loop.ask(1)
    again = loop.ask(2)
    assert again is not None
    assert "[1.2]" in again.overrides[-1]
    assert again.start == first.start
    rows = {row["trial"]: row for row in loop.summary()}
    assert rows["trial0"]["novel"] is True
    assert json.dumps(rows["trial0"])


def test_novel_policies_go_on_after_a_kill(searched: Path) -> None:
    def shown(trial: Trial) -> dict[str, float]:
        return {"angle": 1.0 + 0.3 * int(trial.key[5:]), "success_rate": 1.0}

    told = carry_on(novel(searched), shown)
    assert len([e for e in told if isinstance(e, Trial)]) == 4
    for cut in (1, 4, 5):
        assert carry_on(novel(searched), shown, told[:cut]) == told


def test_without_strategies_there_is_nothing_to_begin_with(searched: Path, tmp_path: Path) -> None:
    with pytest.raises(ConfigError, match="has found no strategy"):
        novel(searched, success=1.0, features={"angle": {"low": 0, "high": 1}, **{}}, distinct=0.2,
              **{"search": str(_failed(tmp_path / "other"))})  # fmt: skip
    with pytest.raises(ConfigError, match="is no folder of a search"):
        novel(tmp_path / "nowhere")


def _failed(folder: Path) -> Path:
    folder.mkdir()
    journal = Journal(folder / "journal.jsonl")
    journal.ask(Trial("trial0", point={"a.x": 0.5}))
    journal.tell(Report("trial0", "ok", 0.0, {"angle": 0.5, "success_rate": 0.0}, 10.0))
    return folder


def test_strategies_of_a_search_that_was_moved_are_where_it_is(tmp_path: Path) -> None:
    (tmp_path / "here").mkdir()
    searched_in(tmp_path / "here")
    (tmp_path / "here").rename(tmp_path / "there")
    trial = novel(tmp_path / "there").ask(0)
    assert trial is not None
    assert trial.start is not None
    assert trial.start["run"] == str(tmp_path / "there" / "trial0")


def test_options_are_data() -> None:
    """What a run's configuration is written from."""
    options = make(DiversitySearch)._options  # type: ignore[attr-defined]
    assert json.dumps(dataclasses.asdict(options))


def test_an_archive_of_too_many_cells_is_refused() -> None:
    """As of a rotation's six numbers; it would not fit any memory."""
    with pytest.raises(ValueError, match="fewer features"):
        MapElites.Options(**rotation_options())


def test_what_has_no_objective_is_no_elite() -> None:
    """It counted as 0 and took the cell of one below that: steps then went out from it."""
    loop = make(MapElites, initial=1, step=1e-6)
    for number, (x, objective) in enumerate([(0.9, -1.0), (0.1, None)]):
        trial = Trial(f"trial{number}", point={"a.x": x, "a.y": 0.5})
        loop.recall(trial)
        loop.tell(Report(trial.key, "ok", objective, {"angle": 1.0, "success_rate": 1.0}, 10.0))
    trial = loop.ask(2)
    assert trial is not None
    assert trial.point["a.x"] == pytest.approx(0.9, abs=1e-3)
