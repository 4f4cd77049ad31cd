"""Searches compared by one command: each goes on in its own folder, and one page shows them."""

from __future__ import annotations

import csv
import json
import shutil
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from understudy.command.cli import main
from understudy.errors import ConfigError
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_reproduce.comparison import Comparison, Found, found_by
from understudy_reproduce.tables import PaperTable, load_table
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial

QUICK = (
    "learner.rollout_steps=8",
    "learner.minibatches=1",
    "budget.samples=512",
    "evaluation.criterion=null",
    "evaluation.every_samples=512",
    "evaluation.episodes=4",
    "evaluation.final_episodes=4",
    "evaluation.seconds=0.5",
    "run.video_seconds=0",
    "outer_loop.trials=3",
    "outer_loop.initial=2",
    "outer_loop.budget=null",
    "outer_loop.epsilon=1e9",
)


def lines(path: Path) -> list[dict[str, str]]:
    with open(path, encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_one_command_runs_the_searches_and_leaves_their_page(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["reproduce", "cmfbo/toy", *QUICK, f"run.dir={tmp_path}", "--seeds", "0,1"]
    assert main([*words, "--columns", "cmfbo", "--seeds", "0"]) == 0
    first = tmp_path / "jumper" / "cmfbo" / "seed0" / "journal.jsonl"
    before = first.read_text()
    assert main([*words, "--columns", "cmfbo,without_transfer"]) == 0
    assert first.read_text() == before, "a finished search is not run again"
    folders = {p.parent.relative_to(tmp_path).as_posix() for p in tmp_path.rglob("journal.jsonl")}
    assert folders == {f"jumper/{c}/seed{s}" for c in ("cmfbo", "without_transfer") for s in (0, 1)}
    starts = [
        [json.loads(line)["trial"]["start"] for line in path.read_text().splitlines()
         if json.loads(line)["event"] == "asked"]
        for path in sorted(tmp_path.rglob("seed0/journal.jsonl"))
    ]  # fmt: skip
    assert [s[-1] is None for s in starts] == [False, True], "the columns are what is compared"
    found = lines(tmp_path / "card.csv")
    assert [(r["column"], r["seed"], r["finished"]) for r in found] == [
        (c, s, "True") for c in ("cmfbo", "without_transfer") for s in "01"
    ]
    for row in found:
        folder = tmp_path / "jumper" / row["column"] / f"seed{row['seed']}"
        told = json.loads((folder / "summary.json").read_text())
        whole = [r["y"] for r in told if r["fidelity"] == 1.0]
        assert float(row["best"]) == pytest.approx(max(whole))
        counted = [r["samples"] for r in told if r["counts"]]
        assert float(row["samples"]) == sum(counted), "what the first trials cost is no budget's"
        assert 0 < len(counted) < len(told)
        assert int(row["whole_trials"]) == len(whole)
    assert "4 of 4 searches are finished" in capsys.readouterr().out
    page = (tmp_path / "card.html").read_text()
    assert page.count('class="series-band"') == 2
    assert "without\\_transfer" in (tmp_path / "card.md").read_text()


def test_a_card_of_what_is_there_trains_nothing(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["reproduce", "cmfbo/toy", "--card", f"run.dir={tmp_path}"]) == 0
    assert "0 of 30 searches are finished, 0 begun" in capsys.readouterr().out
    assert not list(tmp_path.rglob("journal.jsonl"))


def test_a_card_needs_nothing_that_trains(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The searches of `docs/benchmarks` ran on GPUs; their journals are shown wherever they are."""
    journals = Path(__file__).parents[3] / "docs" / "benchmarks" / "cmfbo_figure_6_5"
    shutil.copytree(journals, tmp_path, dirs_exist_ok=True)
    words = ["reproduce", "cmfbo/figure_6_5", "--card", "--seeds", "0", f"run.dir={tmp_path}"]
    assert main([*words, "simulator=mujoco_warp"]) == 0
    assert "6 begun" in capsys.readouterr().out
    assert {row["column"] for row in lines(tmp_path / "card.csv")} >= {"cmfbo", "gp_ucb"}


@pytest.mark.parametrize("name", ["cmfbo/toy", "cmfbo/figure_6_3", "cmfbo/figure_6_5"])
def test_every_search_of_a_table_can_be_composed(name: str, tmp_path: Path) -> None:
    """Nothing else says so before a GPU is waiting."""
    if "figure" in name:
        pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    comparison = Comparison(name, load_table(name, installed()), tmp_path, [])
    loops = {}
    for row, column in comparison._cells():
        experiment = load_experiment(comparison.overrides_of(row, column, 3))
        loops[column] = experiment.need("outer_loop").component.name
        assert experiment.root.seed == 3
        loop = experiment.need("outer_loop").build(3)
        trial = loop.ask(0)
        assert ("budget.samples" in trial.point) == (column == "boca_iterations")
        assert ("control.substeps" in trial.point) == (column == "resolution")
        assert (trial.fidelity is None) == (column in ("boca_iterations", "gp_ucb", "resolution"))
    for variant in ("as_printed", "cmfbo_unbounded", "resolution"):
        assert loops.pop(variant, "cmfbo") == "cmfbo"
    assert loops == {
        "cmfbo": "cmfbo", "without_transfer": "cmfbo", "boca_curriculum": "boca",
        "boca_iterations": "boca", "gp_ucb": "gp_ucb",
    }  # fmt: skip


def test_the_table_of_deepmimics_settings_composes() -> None:
    pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    table = load_table("deepmimic/figure_6_7", installed())
    found = {k: load_experiment(v).need("learner").options for k, v in table.variants().items()}
    for skill in ("walk", "run", "cartwheel"):
        assert found[f"{skill}/released"].batch_size == 4 * 256
        assert found[f"{skill}/optimised"].batch_size == 4 * 172


def search(tmp_path: Path, *events: Trial | Report) -> Found:
    """What GP-UCB or CMFBO (by the events' fidelities) found in these events."""
    journal = Journal(tmp_path / "journal.jsonl")
    for event in events:
        journal.ask(event) if isinstance(event, Trial) else journal.tell(event)
    options = [
        "search=cmfbo/toy", "outer_loop.parameters={seed: {low: 0, high: 9}}",
        "outer_loop.sample_scale=null", "outer_loop.trials=4",
    ]  # fmt: skip
    parameters = load_experiment(options).need("outer_loop").options.parameters
    point = {name: parameter.low for name, parameter in parameters.items()}
    journal.events = [
        Trial(e.key, point=point, fidelity=e.fidelity) if isinstance(e, Trial) else e
        for e in journal.events
    ]
    return found_by(load_experiment(options).need("outer_loop").build(0), journal, 7)[""]


def test_the_best_is_of_whole_trials_in_the_order_in_which_they_ended(tmp_path: Path) -> None:
    found = search(
        tmp_path,
        Trial("trial0", fidelity=0.0),
        Trial("trial1", fidelity=1.0),
        Trial("trial2", fidelity=1.0),
        Report("trial0", "ok", 9.0, cost=100),
        Report("trial2", "ok", 1.0, cost=50),
        Report("trial1", "ok", 3.0, cost=20),
        Trial("trial3", fidelity=1.0),
        Report("trial3", "failed: why", cost=30),
    )
    assert found.curve[:, 0].tolist() == [100, 150, 170, 200]
    np.testing.assert_equal(found.curve[:, 1], [np.nan, 1.0, 3.0, 3.0])
    assert (found.whole, found.seed, found.finished) == (3, 7, True)
    assert [found.best(s) for s in (120, 150, 169, 1e9)] == [None, 1.0, 1.0, 3.0]
    assert found.steps().tolist() == [[150, 1], [170, 1], [170, 3], [200, 3], [200, 3]]
    assert found.steps(300).tolist()[-2:] == [[300, 3], [300, 3]]
    assert replace(found, finished=False).steps(300).tolist() == found.steps().tolist()


def test_what_is_no_search_by_value_is_refused(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    loop = load_experiment(["experiment=miniature/go", "outer_loop=grid"]).need("outer_loop")
    grid = loop.build(0)
    journal.ask(grid.plan[0])
    journal.tell(Report(grid.plan[0].key, "ok", 1.0))
    with pytest.raises(ConfigError, match="Grid does not say what its trials are worth"):
        found_by(grid, journal, 0)


def test_values_are_compared_at_equal_samples(tmp_path: Path) -> None:
    table = PaperTable("t", "s", {"r": ()}, {"a": (), "b": ()}, seeds=(0, 1), searches=True)
    comparison = Comparison("x/y", table, tmp_path, [])
    curve = np.array([[10.0, 1.0], [20.0, 2.0], [90.0, 9.0]])
    lower = np.array([[10.0, np.nan], [30.0, 0.5]])
    up = np.array([0, 1])
    comparison.found = {
        ("r", "a"): [Found(0, curve, 3, True), Found(1, curve + up, 3, True)],
        ("r", "b"): [Found(0, lower, 1, True), Found(1, lower + up, 1, True)],
    }
    ((_, shown),) = list(comparison.tables())
    assert shown.heads[1] == "best value after 30 samples"
    a, b = shown.rows
    assert a[1] == "2.5 (2)"
    assert b[1] == "1 (2)"
    assert b[2] == "-1.5 (2 seeds)"
    assert a[3].startswith("9.5 (2)")
    assert (a[4], a[6], b[6]) == ("90", "3 (3), 3 (3)", "2 (1), 2 (1)")
    comparison.found["r", "b"] = [Found(0, lower, 1, True), Found(1, lower[:1])]
    _, b = next(comparison.tables())[1].rows
    assert b[1] == b[3] == "0.5 (1); 1 still running", "it is not compared before it is there"
    assert b[2] == "-1.5"
    comparison.found["r", "b"] = [Found(0, lower[:1], 0, True)]
    ((_, shown),) = list(comparison.tables())
    assert shown.heads[1] == "best value after 10 samples"
    assert shown.rows[1][1:4] == ["1 without one", "–", "1 without one"]
