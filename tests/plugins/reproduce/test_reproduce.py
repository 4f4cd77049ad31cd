"""A table of two rows and two columns, run on a miniature by one command: its card, and going on."""

from __future__ import annotations

import csv
import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Literal

import pytest

from understudy.command.cli import main
from understudy.errors import ConfigError, FileError
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_reinforcement.resolution import resolution_of
from understudy_report.markup import check_markup
from understudy_reproduce import card as card_module
from understudy_reproduce import command, tables
from understudy_reproduce.card import Card, Cell
from understudy_reproduce.tables import Figure, PaperTable, load_table, table_files
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.results import Result

TABLE = """
title: How near a point gets, <b>by far</b>
source: A paper, table 1
overrides: [budget.samples=1024, evaluation.every_samples=1024, evaluation.gate=0.0]
rows:
  calm: [experiment=miniature/go]
  quick: [experiment=miniature/go, 'learner={name: ppo, rollout_steps: 8, minibatches: 4}']
columns:
  small: []
  large: ['policy.hidden=[64, 64]']
without: [quick/large]
figures:
  - {of: distance, title: 'Distance, m'}
  - {of: return}
  - {of: seconds}
paper:
  calm: {small: 0.5, large: much nearer}
seeds: [0, 1]
deviations: [The paper's point is heavier.]
"""
SMALL = ("evaluation.episodes=4", "evaluation.final_episodes=4", "evaluation.seconds=0.5")


@pytest.fixture
def offered(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> Callable[[str], Path]:
    """Makes its text the table ``mine/one`` of some plugin."""
    file = tmp_path / "one.yaml"

    def offer(text: str) -> Path:
        file.write_text(text, encoding="utf-8")
        monkeypatch.setattr(tables, "table_files", lambda plugins: {"mine/one": file})
        monkeypatch.setattr(command, "table_files", lambda plugins: {"mine/one": file})
        return file

    return offer


def reproduce(*words: str) -> int:
    return main(["reproduce", *words])


def rows_of(folder: Path) -> dict[tuple[str, str, str], dict[str, str]]:
    with open(folder / "card.csv", encoding="utf-8") as file:
        return {(r["row"], r["column"], r["figure"]): r for r in csv.DictReader(file)}


def test_one_command_runs_the_table_and_leaves_its_card(
    offered: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    offered(TABLE)
    folder = tmp_path / "out"
    words = ("mine/one", *SMALL, f"run.dir={folder}")
    assert reproduce(*words, "--rows", "calm", "--seeds", "0") == 0
    asked = [t.key for t in Journal.read(folder / "journal.jsonl").asked]
    assert asked == ["calm/small/seed0", "calm/large/seed0"]
    assert reproduce(*words) == 0  # goes on with the rest
    asked = [t.key for t in Journal.read(folder / "journal.jsonl").asked]
    assert sorted(asked) == sorted(
        f"{v}/seed{s}" for v in ("calm/small", "calm/large", "quick/small") for s in (0, 1)
    )
    found = rows_of(folder)
    reports = Journal.read(folder / "journal.jsonl").finished
    of_seeds = [reports[f"calm/small/seed{s}"].measures["distance"] for s in (0, 1)]
    cell = found["calm", "small", "distance"]
    assert float(cell["mean"]) == pytest.approx(sum(of_seeds) / 2)
    assert (cell["low"], cell["high"]) == ("", ""), "two seeds have no interval"
    assert (cell["paper"], cell["seeds"]) == ("0.5", "2")
    assert found["calm", "large", "distance"]["paper"] == "much nearer"
    assert found["calm", "small", "return"]["paper"] == ""
    assert found["quick", "large", "distance"]["seeds"] == "0"
    text = (folder / "card.md").read_text()
    assert "6 of 6 trainings are finished" in text
    assert "minutes of training on cpu" in text
    assert "The paper's point is heavier." in text
    assert "| calm | 0.5 |" in text
    page = (folder / "card.html").read_text()
    assert "<b>by far</b>" not in page
    assert "&lt;b&gt;by far&lt;/b&gt;" in page
    run = json.loads((folder / "quick%2Fsmall%2Fseed1" / "run.json").read_text())
    assert run["config"]["learner"]["rollout_steps"] == 8
    before = (folder / "card.csv").read_text()
    assert reproduce("mine/one", f"run.dir={folder}", "--card") == 0
    assert (folder / "card.csv").read_text() == before
    assert "card: " in capsys.readouterr().out
    journal = tmp_path / "journal alone"
    journal.mkdir()
    shutil.copy(folder / "journal.jsonl", journal)
    assert reproduce("mine/one", f"run.dir='{journal}'", "--card") == 0
    alone, whole = rows_of(journal), rows_of(folder)
    assert alone["calm", "small", "distance"]["mean"] == whole["calm", "small", "distance"]["mean"]
    assert alone["calm", "small", "distance"]["minutes"] == ""
    text = (journal / "card.md").read_text()
    assert "finished; the run folders of 6 are not here, so minutes and machine" in text
    assert "0.0" not in text.partition("## Minutes of training")[2].partition("Ours are")[0]


def result(samples: float, outcome: str = "criterion", status: str = "ok", seed: int = 0) -> Result:
    report = Report("x", status, 1.0, {"success_from_here": 0.5}, samples, "", outcome)
    return Result(Trial("x", variant="a/b", seed=seed), report, Path("nowhere"))


def test_samples_of_what_did_not_get_there_are_not_averaged() -> None:
    cell = Cell([result(2e6), result(4e6), result(8e6, "budget"), result(1.0, "", "failed: why")])
    assert cell.values("samples") == [2e6, 4e6]
    text = cell.text(Figure("samples"))
    assert text == "3M (2); 1 not within 8M; 1 failed"
    assert Cell([result(8e6, "budget")]).text(Figure("samples")) == "1 not within 8M"
    assert cell.text(Figure("success_from_here")).startswith("50 %")
    assert Cell([]).text(Figure("samples")) == "–"


def test_a_share_of_episodes_is_in_per_cent_and_within_them() -> None:
    reports = [
        Report("x", "ok", 1.0, {"fell": share, "energy": share}, 1e6, "", "budget")
        for share in (0.0, 0.1, 0.2)
    ]
    cell = Cell([Result(Trial("x", variant="a/b", seed=0), r, Path("nowhere")) for r in reports])
    assert cell.text(Figure("fell", share=True)) == "10 % [0, 34.8] (3)"
    assert cell.text(Figure("energy")).startswith("0.1 [-0.148, ")


def test_a_figure_may_be_the_last_value_of_a_metric() -> None:
    """One that is not in every row, of a learner that has it; another has none."""
    rows = [{"model_error_8": 0.5}, {"model_error_8": 0.25, "samples": 2}, {"samples": 3}]
    learned = Cell([replace(result(2e6), rows=rows)])
    assert learned.values("metrics/model_error_8") == [0.25]
    assert learned.values("metrics/samples") == [3.0]
    other = Cell([replace(result(2e6), rows=[{"samples": 3}])])
    assert other.text(Figure("metrics/model_error_8")) == "–"


def test_an_unfinished_table_has_a_card(tmp_path: Path) -> None:
    table = PaperTable("A title", "a paper", {"a": ("experiment=miniature/go",)})
    card = Card("mine/one", table, tmp_path / "none")
    assert "0 of 3 trainings are finished" in card.headline()
    assert card.write().exists()
    check_markup((tmp_path / "none" / "card.html").read_text().partition("<main")[2].partition(">")[2].partition("</main>")[0])  # fmt: skip


@pytest.mark.parametrize(
    ("change", "why"),
    [
        (("rows:", "raws:"), "has no option 'raws'"),
        (("seeds: [0, 1]", "seeds: []"), "must not be empty"),
        (("  calm: {small: 0.5,", "  calm: {smal: 0.5,"), "paper names 'smal'"),
        (("calm: [exp", "'ca;lm': [exp"), "other signs than letters"),
        (("{of: return}", "{fo: return}"), "has no option 'fo'"),
    ],
)
def test_a_wrong_table_is_refused_with_its_place(
    offered: Callable[[str], Path], change: tuple[str, str], why: str
) -> None:
    offered(TABLE.replace(*change))
    with pytest.raises(ConfigError, match=why) as caught:
        load_table("mine/one", installed())
    assert "reproduction/mine/one" in str(caught.value)


def test_a_file_that_is_no_table(offered: Callable[[str], Path]) -> None:
    offered("title: [")
    with pytest.raises(FileError, match="is no table"):
        load_table("mine/one", installed())
    offered("!!python/object/apply:os.system ['true']")
    with pytest.raises(FileError, match="is no table"):
        load_table("mine/one", installed())


def test_what_is_not_there_is_named(
    offered: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    offered(TABLE)
    assert reproduce("mine/on") == 2
    assert "Did you mean 'mine/one'?" in capsys.readouterr().err
    assert reproduce("mine/one", "--rows", "clam") == 2
    assert "--rows: there is no 'clam'. Did you mean 'calm'?" in capsys.readouterr().err
    assert reproduce() == 0
    assert capsys.readouterr().out.startswith("mine/one: How near a point gets, <b>by far</b> (")


def test_a_table_that_another_command_makes_names_it(
    offered: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    offered(TABLE + "\ncommand: make tea\n")
    assert reproduce("mine/one") == 2
    assert "is made by another command: make tea" in capsys.readouterr().err


def test_a_variant_that_cannot_be_composed_stops_it_before_anything_runs(
    offered: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    offered(TABLE.replace("policy.hidden=[64, 64]", "policy.hiden=[64, 64]"))
    assert reproduce("mine/one", *SMALL, f"run.dir={tmp_path / 'out'}") == 2
    assert "Variant 'calm/large' cannot be run" in capsys.readouterr().err
    assert not (tmp_path / "out" / "calm%2Fsmall%2Fseed0").exists()


@pytest.mark.slow
@pytest.mark.parametrize("name", sorted(table_files(installed())))
def test_every_cell_of_a_bundled_table_can_be_composed(name: str) -> None:
    """A sweep composes all before anything runs, which is when a GPU is waiting."""
    table = load_table(name, installed())
    if table.searches or table.command:  # searches are composed in test_comparison.py
        return
    for cell in table.variants().values():
        load_experiment([*table.overrides, *cell])


@pytest.mark.parametrize("name", sorted(table_files(installed())))
def test_what_is_compared_with_a_paper_is_trained_by_its_own_physics(name: str) -> None:
    """Coarse physics at first changes how many samples are needed (docs/decisions/0033)."""
    table = load_table(name, installed())
    if table.source.startswith("No paper's") or table.searches or table.command:
        return
    column = next(iter(table.columns.values()))
    for row in table.rows.values():
        experiment = load_experiment([*table.overrides, *row, *column])
        assert resolution_of(experiment).substeps is None


def test_every_bundled_table_can_be_listed() -> None:
    names = list(tables.table_files(installed()))
    assert "spacetime/table_3_1" in names
    for name in names:
        table = load_table(name, installed())
        assert table.variants()
        if not table.searches and not table.command:  # searches are composed in test_comparison.py
            assert command.experiment_of(table)
            assert card_module.Card(name, table, Path("nowhere")).text()


@pytest.mark.parametrize(
    ("samples", "expected"),
    [((1.0, 1.1, 1.2), "holds"), ((3.0, 3.1, 3.2), "does not hold"), ((1.0, 3.0, 2.5), "undecided"),
     ((1.0,), "one seed")],
)  # fmt: skip
def test_a_verdict_says_whether_ours_is_better(samples: tuple[float, ...], expected: str) -> None:
    cell = Cell([result(s, seed=i) for i, s in enumerate(samples)])
    assert cell.verdict("samples", 2.0, "less") == expected


@pytest.mark.parametrize(
    ("had", "better", "expected"),
    [(1.0, "less", "undecided"), (3.0, "less", "does not hold"), (3.0, "more", "holds"),
     (1.0, "more", "undecided")],
)  # fmt: skip
def test_what_missed_its_criterion_needs_more_than_it_had(
    had: float, better: Literal["less", "more"], expected: str
) -> None:
    missed = [result(had + i / 10, outcome="budget", seed=i) for i in range(3)]
    assert Cell(missed).verdict("samples", 2.0, better) == expected


def test_the_list_has_every_table_with_the_papers_number_and_ours(
    offered: Callable[[str], Path], capsys: pytest.CaptureFixture[str]
) -> None:
    offered(TABLE + "\ncost: seconds\nopen: the rest\n")
    assert reproduce() == 0
    shown = capsys.readouterr().out
    assert "mine/one: " in shown
    assert "calm, small: paper 0.5; ours –" in shown
    assert "takes: seconds" in shown
    assert "not run yet: the rest" in shown


@pytest.mark.parametrize("name", sorted(table_files(installed())))
def test_every_table_says_what_it_takes(name: str) -> None:
    table = load_table(name, installed())
    assert table.cost or "toy" in name
    assert table.open or "toy" in name


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (["--rows", ""], "--rows: a name is needed, and there is none, as of an empty variable"),
        (["--columns", "small,"], "--columns: a name is needed, and in 'small,' there is none"),
        (["--seeds", ""], "--seeds: a name is needed, and there is none, as of an empty variable"),
        (["--seeds", "0,0"], "--seeds: 0 stands twice, and is trained once"),
        (["--seeds=-1"], "--seeds: -1 is not possible: seeds are from 0 to"),
        (["--seeds", str(2**63)], f"--seeds: {2**63} is not possible: seeds are from 0 to"),
        (["--seeds", "0-2"], "--seeds: '0-2' is not possible: whole numbers, as in 0,1"),
        (["run.dir="], "run.dir= names no folder, as of an empty variable"),
        (["--records", "."], "--records is of the list of all tables"),
    ],
)
def test_a_choice_of_nothing_is_not_one_of_everything(
    offered: Callable[[str], Path],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
    words: list[str],
    why: str,
) -> None:
    """As of a variable of a script that is not set, with which all of the table would be trained."""
    offered(TABLE)
    monkeypatch.chdir(tmp_path)
    before = sorted(tmp_path.rglob("*"))
    assert reproduce("mine/one", "--card", *words) == 2
    assert why in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


@pytest.mark.parametrize("word", ["--card", "--rows=calm", "--columns=small", "--seeds=0"])
def test_what_is_of_one_table_is_not_taken_for_the_list(
    word: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert reproduce(word) == 2
    assert "is of one table: name it, PAPER/TABLE, too" in capsys.readouterr().err


def test_names_may_have_blanks_around_them(offered: Callable[[str], Path], tmp_path: Path) -> None:
    offered(TABLE)
    words = ("--rows", "calm , quick", "--columns", " small", "--seeds", "0, 1")
    assert reproduce("mine/one", "--card", *words, f"run.dir={tmp_path / 'out'}") == 0
    found = rows_of(tmp_path / "out")
    assert {(row, column) for row, column, _ in found} == {("calm", "small"), ("quick", "small")}


@pytest.mark.parametrize("typed", ["'{}'", '"{}"', "{}"])
def test_a_folder_is_named_as_everywhere(
    offered: Callable[[str], Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch, typed: str
) -> None:
    offered(TABLE)
    monkeypatch.chdir(tmp_path)
    assert reproduce("mine/one", "--card", "run.dir=" + typed.format("my runs/one")) == 0
    assert (tmp_path / "my runs/one/card.md").exists()
    assert reproduce("mine/one", "--card", "run.dir=null") == 0
    assert (tmp_path / "runs/reproduce/mine/one/card.md").exists()


def test_a_card_is_not_written_into_what_is_another_ones(
    offered: Callable[[str], Path], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A training's folder, one with other things, a file, a link to nothing; nothing is left behind."""
    offered(TABLE)
    (tmp_path / "run").mkdir()
    (tmp_path / "run" / "run.json").write_text("{}")
    for name in ("html/index.html", "card/card.md", "csv/card.csv", "tree/src/code.py"):
        (tmp_path / name).parent.mkdir(parents=True)
        (tmp_path / name).write_text("mine")
    (tmp_path / "file").write_text("mine")
    (tmp_path / "dangling").symlink_to("nowhere")
    before = {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")}
    for name, why in {
        "run": "is the run",
        "run/inner": "is inside the run",
        "html": "is not new: it holds index.html",
        "card": "is not new: it holds card.md",
        "csv": "is not new: it holds card.csv",
        "tree": "is not new: it holds src/code.py",
        "file": "is no folder",
        "file/inner": "cannot be used: Not a directory",
        "dangling": "is no folder",
    }.items():
        for words in (["--card"], [*SMALL, "--seeds", "0"]):
            assert reproduce("mine/one", *words, f"run.dir={tmp_path / name}") == 2, name
            assert f"{tmp_path / name} {why}" in capsys.readouterr().err.replace("The folder ", "")
    assert {path: path.is_file() and path.read_text() for path in tmp_path.rglob("*")} == before


@pytest.mark.parametrize("mark", ["reproduction.json", "card.md"])
def test_no_table_counts_trainings_of_another(
    offered: Callable[[str], Path],
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
    mark: str,
) -> None:
    """Tables of one paper may call their cells alike; the folder is told by its own file, and before there was one by its card."""
    file = offered(TABLE)
    words = (*SMALL, f"run.dir={tmp_path / 'out'}")
    assert reproduce("mine/one", *words, "--rows", "calm", "--columns", "small") == 0
    for name in ("reproduction.json", "card.md"):
        if name != mark:
            (tmp_path / "out" / name).unlink()
    before = {path: path.read_bytes() for path in (tmp_path / "out").rglob("*") if path.is_file()}
    for module in (tables, command):
        monkeypatch.setattr(module, "table_files", lambda plugins: {"mine/other": file})
    capsys.readouterr()
    for more in (["--card", words[-1]], words):
        assert reproduce("mine/other", *more) == 2
        assert "out holds another table, mine/one. Give run.dir another" in capsys.readouterr().err
    assert before == {p: p.read_bytes() for p in (tmp_path / "out").rglob("*") if p.is_file()}
