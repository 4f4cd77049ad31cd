"""What a sweep shows: its tables, and its page in a browser that has no network."""

from __future__ import annotations

import csv
import io
import json
import os
import time
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from browsers import opened

from understudy.command.cli import main
from understudy.errors import RunError
from understudy_motion.readers import npz
from understudy_reinforcement.evaluation import wilson_interval
from understudy_sweeps import film as film_module
from understudy_sweeps import page as page_module
from understudy_sweeps import tables
from understudy_sweeps.film import Tile, columns_of, make_film
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.page import Page
from understudy_sweeps.progress import describe, time_left
from understudy_sweeps.results import Result, Results, best_of, variants_of
from understudy_sweeps.trial import folder_of

EVIL = "<img src=x onerror=document.title='taken'>"
PAPER = {
    "caption": "Table 3 of the paper",
    "of": "objective",
    "values": {"full": 0.9, "third": 0.1},
}


def add(
    folder: Path,
    journal: Journal,
    trial: Trial,
    objective: float | None = None,
    samples: float = 100.0,
    outcome: str = "budget",
    **measures: float,
) -> None:
    """A trial as it would be in the folder: finished with `objective`, or failed."""
    journal.ask(trial)
    path = folder_of(trial.key, folder)
    path.mkdir(parents=True)
    rows = [
        {"iteration": i, "samples": i * samples / 4, "seconds": 2.0 * i, "episode/return": i + 0.1}
        for i in range(1, 5)
    ]
    rows[-1] |= {f"evaluation/{name}": value for name, value in measures.items()}
    (path / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    evaluation = {"objective": {"name": "reach", "value": objective}, "episodes": 64}
    (path / "evaluation.json").write_text(json.dumps(evaluation))
    if objective is None:
        journal.tell(Report(trial.key, f"failed: {EVIL}", cost=samples))
    else:
        figures = {"reach": objective, **measures}
        journal.tell(Report(trial.key, "ok", objective, figures, samples, str(path), outcome))


@pytest.fixture
def ablation(tmp_path: Path) -> tuple[Path, Journal]:
    """Two variants: seeds 0, 1, 2, and seeds 0, 1 with a third that failed."""
    journal = Journal(tmp_path / "journal.jsonl")
    for seed, (full, bare) in enumerate([(0.8, 0.5), (0.9, 0.7), (0.7, None)]):
        for name, objective in (("full", full), (EVIL, bare)):
            trial = Trial(f"{name}/seed{seed}", variant=name, seed=seed)
            outcome = "criterion" if name == "full" else "budget"
            add(tmp_path, journal, trial, objective, 100 + seed, outcome, success_rate=0.25)
    return tmp_path, journal


def results_of(given: tuple[Path, Journal]) -> list[Result]:
    return Results(given[0]).of(given[1])


def column(table: tables.Table, name: str) -> list[str]:
    return [row[list(table.heads).index(name)] for row in table.rows]


def test_the_table_of_variants(ablation: tuple[Path, Journal]) -> None:
    table = tables.compared(variants_of(results_of(ablation)), PAPER)
    assert list(table.heads) == [
        "variant", "seeds", "success", "reach", "paper", "samples", "reached the criterion",
        "training", "against full",
    ]  # fmt: skip
    assert column(table, "variant") == ["full", EVIL]
    assert column(table, "seeds") == ["3", "2 (1 failed)"]
    # Means 0.8 and 0.6; s = 0.1, reach 4.3027 · 0.1 / √3; two have no interval.
    assert column(table, "reach") == ["0.8 [0.552, 1.05]", "0.6 (2 seeds)"]
    assert column(table, "paper") == ["0.9", "–"]
    assert column(table, "reached the criterion") == ["3 of 3", "0 of 2"]
    assert column(table, "samples")[1] == "100 (2 seeds)"
    # Differences -0.3 and -0.2 of the seeds that both have.
    assert column(table, "against full") == ["–", "-0.25 (2 seeds)"]
    assert column(table, "success") == ["25 % [25, 25]", "25 % (2 seeds)"]


@pytest.mark.parametrize("share", [True, False])
def test_a_share_has_an_interval_that_is_possible(tmp_path: Path, share: bool) -> None:
    """A measure whose own intervals are Wilson's is a share of episodes; of others 1.02 may well be."""
    journal = Journal(tmp_path / "journal.jsonl")
    for name, values in (("a", (1.0, 1.0, 0.96875)), ("b", (0.0, 0.0, 0.03125))):
        for seed, value in enumerate(values):
            trial = Trial(f"{name}/seed{seed}", variant=name, seed=seed)
            add(tmp_path, journal, trial, value, inside=value)
            bounds = wilson_interval(value, 64) if share else (value - 0.01, value + 0.01)
            measure = {"reduce": "last", "mean": value, "mean_95": list(bounds)}
            file = folder_of(trial.key, tmp_path) / "evaluation.json"
            said = {
                "objective": {"name": "inside"},
                "episodes": 64,
                "measures": {"inside": measure},
            }
            file.write_text(json.dumps(said))
    variants = variants_of(Results(tmp_path).of(journal))
    table, compared = tables.all_measures(variants), tables.compared(variants, None)
    inside = next(row for row in table.rows if row[0] == "inside")
    assert column(compared, "inside") == inside[1:]
    assert inside[1] == ("0.99 [0.945, 1]" if share else "0.99 [0.945, 1.03]")
    assert inside[2] == ("0.0104 [0, 0.0552]" if share else "0.0104 [-0.0344, 0.0552]")
    assert column(compared, "against a")[1] == (
        "-0.979 [-1, -0.89]" if share else "-0.979 [-1.07, -0.89]"
    )
    high = float(
        next(csv.DictReader(io.StringIO(tables.compared_csv(variants, None).decode())))[
            "inside_high"
        ]
    )
    assert (high <= 1.0) is share


def test_one_seed_has_no_interval(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    add(tmp_path, journal, Trial("a/seed0", variant="a", seed=0), 0.5)
    table = tables.compared(variants_of(Results(tmp_path).of(journal)), None)
    assert column(table, "reach") == ["0.5"]
    assert "paper" not in table.heads


def test_numbers_of_the_paper_of_a_measure(ablation: tuple[Path, Journal]) -> None:
    paper = {**PAPER, "of": "success_rate", "values": {"full": 0.94}}
    table = tables.compared(variants_of(results_of(ablation)), paper)
    assert table.heads[2:4] == ["success", "paper"]
    assert column(table, "paper") == ["94 %", "–"]


def test_csv_has_every_digit(ablation: tuple[Path, Journal]) -> None:
    results = results_of(ablation)
    first, second = csv.DictReader(
        io.StringIO(tables.compared_csv(variants_of(results), PAPER).decode())
    )
    assert float(first["objective_low"]) == pytest.approx(0.8 - 4.302653 * 0.1 / 3**0.5, abs=1e-6)
    assert (first["paper"], second["paper"]) == ("0.9", "")
    assert float(second["objective_difference"]) == pytest.approx(-0.25)
    rows = list(csv.DictReader(io.StringIO(tables.trials_csv(results).decode())))
    assert [r["seed"] for r in rows] == ["0", "0", "1", "1", "2", "2"]
    assert rows[-1]["status"].startswith("failed: ")


def test_a_spreadsheet_gets_no_formula(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    add(tmp_path, journal, Trial("=cmd()/seed0", variant="=cmd()", seed=0), 0.5)
    results = Results(tmp_path).of(journal)
    assert tables.trials_csv(results).decode().splitlines()[1].startswith("'=cmd()")


def test_a_spreadsheet_gets_no_formula_in_heads_and_knows_the_letters(tmp_path: Path) -> None:
    """Names of measures were heads as they were, and a spreadsheet took UTF-8 for another code."""
    journal = Journal(tmp_path / "journal.jsonl")
    add(tmp_path, journal, Trial("fünf/seed0", variant="fünf", seed=0), 0.5, **{"=cmd()": 1.0})
    results = Results(tmp_path).of(journal)
    head, row = tables.compared_csv(variants_of(results), None).decode("utf-8").splitlines()
    assert head.startswith("\ufeffvariant,")
    assert "'=cmd()" in head.split(",")
    assert "=cmd()" not in head.split(",")
    assert row.startswith("fünf,")
    assert tables.as_csv([["a", 1.5, None], ["=b", -2, ""]]) == b"a,1.5,\n'=b,-2,\n"


def test_trials_that_say_different_things_are_in_one_file(tmp_path: Path) -> None:
    """A figure that the first trial lacks left the sweep without a page."""
    found = tables._csv([{"trial": "a"}, {"trial": "b", "y": 0.5}])
    assert found == b"trial,y\na,\nb,0.5\n"


def test_markdown_is_only_text() -> None:
    table = tables.Table(["a", "b"], [["x|y", "[z](http://e)\n<b>"]])
    assert table.markdown().splitlines()[2] == "| x\\|y | \\[z\\](http://e) \\<b\\> |"


@pytest.fixture
def search(tmp_path: Path) -> tuple[Path, Journal]:
    """Three trials; the one of low fidelity has the greatest objective."""
    journal = Journal(tmp_path / "journal.jsonl")
    points: list[Mapping[str, float]] = [{"a.b": 1.0}, {"a.b": 2.0}, {"a.b": 3.0}, {"a.b": 4.0}]
    starts: list[Any] = [None, {"trial": "t0"}, {"trial": "t0"}, None]
    for i, (objective, fidelity) in enumerate([(0.9, 0.2), (0.5, 1.0), (0.7, 1.0), (None, 1.0)]):
        trial = Trial(f"t{i}", point=points[i], fidelity=fidelity, start=starts[i])
        add(tmp_path, journal, trial, objective)
    return tmp_path, journal


def test_the_table_of_a_search(search: tuple[Path, Journal]) -> None:
    """The best of the highest fidelity comes first, and what failed last."""
    table = tables.trials(results_of(search))
    assert column(table, "trial") == ["t2", "t1", "t0", "t3"]
    assert column(table, "began from") == ["t0", "t0", "–", "–"]
    assert column(table, "a.b") == ["3", "2", "1", "4"]
    best = best_of(results_of(search))
    assert best is not None
    assert best.trial.key == "t2"


def test_a_search_is_ranked_by_what_its_loop_maximises(search: tuple[Path, Journal]) -> None:
    """y is not the objective where learning faster is better, and the loop says which trials count."""
    folder, journal = search
    summary = [
        {"trial": "t0", "y": 0.8, "whole": False, "found": "highest y"},
        {"trial": "t1", "y": 0.4, "whole": True, "found": "answer"},
        {"trial": "t2", "y": 0.3, "whole": True, "found": ""},
    ]
    results = Results(folder).of(journal, summary)
    table = tables.trials(results)
    assert column(table, "trial") == ["t1", "t2", "t0", "t3"]
    assert column(table, "y") == ["0.4", "0.3", "0.8", "–"]
    assert column(table, "found") == ["answer", "", "highest y", ""]
    assert b",0.4,answer," in tables.trials_csv(results)
    assert describe(journal, (), 2, summary).endswith("best 0.4 (t1)")
    page = Page(folder, "x")
    page.write(journal, summary)
    text = (folder / "page.md").read_text()
    assert "is 0.5 (y 0.4), of t1" in text
    assert "<td>answer" in (folder / "page.html").read_text()


def test_a_search_without_a_whole_trial_has_no_answer(search: tuple[Path, Journal]) -> None:
    folder, journal = search
    summary = [{"trial": f"t{i}", "y": 0.1, "whole": False} for i in range(3)]
    assert "best" not in describe(journal, (), 2, summary)
    Page(folder, "x").write(journal, summary)
    assert "so there is no answer" in (folder / "page.md").read_text()


def test_candidates_that_share_a_job_have_a_row_each(tmp_path: Path) -> None:
    """With its own score, and none of what was measured of all together."""
    journal = Journal(tmp_path / "journal.jsonl")
    journal.ask(Trial("job0", point={"at.c0.x": 1.0, "at.c1.x": 2.0}))
    journal.tell(Report("job0", "ok", 0.9, {"success_rate": 1.0, "score_c0": 0.3}, 100.0))
    journal.ask(Trial("job1", point={"at.c0.x": 3.0, "at.c1.x": 4.0}))
    done = {"job": "job0", "whole": True, "at.CANDIDATE.x": 1.0, "fidelity": None}
    summary = [
        {**done, "trial": "trial0", "status": "ok", "objective": 0.3, "y": 0.3, "samples": 100.0, "found": "answer"},
        {**done, "trial": "trial1", "status": "failed", "objective": None, "y": None, "samples": 0.0, "at.CANDIDATE.x": 2.0},
        {**done, "trial": "trial2", "status": "running", "objective": None, "y": None, "samples": None, "job": "job1"},
    ]  # fmt: skip
    results = Results(tmp_path).of(journal, summary)
    table = tables.trials(results)
    assert "at.CANDIDATE.x" in table.heads
    assert "success" not in table.heads
    rows = {row[0]: dict(zip(table.heads, row, strict=True)) for row in table.rows}
    assert rows["trial0"]["objective"] == "0.3"
    assert rows["trial1"]["ended by"] == "failed: it could not begin in its job."
    assert rows["trial2"]["ended by"] == "unfinished"
    assert page_module._tiles(results) == [Tile("job0", folder_of("job0", tmp_path))]
    assert "best 0.3 (trial0)" in describe(journal, (), 1, summary)


def test_progress_in_words(search: tuple[Path, Journal]) -> None:
    plan = [f"t{i}" for i in range(6)]
    assert describe(search[1], plan, 2) == "4 of 6 done · 2 running · 1 failed · best 0.7 (t2)"
    other = Journal(search[0] / "other")
    assert describe(other, (), 1) == "0 done · 1 running"
    other.ask(Trial("harvest"))
    other.tell(Report("harvest", "ok"))  # a job without an objective has not failed
    assert describe(other, (), 0) == "1 done · 0 running"


def test_no_variant_is_the_best(ablation: tuple[Path, Journal]) -> None:
    """The one with the greatest objective may be the worst: how far the farthest particle is, say."""
    plan = [f"{name}/seed{seed}" for name in ("full", EVIL) for seed in range(3)]
    assert describe(ablation[1], plan, 0) == "6 of 6 done · 0 running · 1 failed"


def test_trials_that_other_calls_asked_for_are_not_counted(
    ablation: tuple[Path, Journal],
) -> None:
    plan = ["full/seed0", "full/seed1", "full/seed7"]
    assert describe(ablation[1], plan, 1) == "2 of 3 done · 1 running"


def test_a_rate_without_its_episodes_has_no_interval(ablation: tuple[Path, Journal]) -> None:
    """The journal alone is left of a sweep whose runs were deleted."""
    folder, journal = ablation
    for found in folder.rglob("evaluation.json"):
        found.unlink()
    table = tables.trials(results_of((folder, journal)))
    assert column(table, "success")[0] == "25 %"


def test_the_time_left() -> None:
    assert time_left(60.0, 0.2, 0.5) == pytest.approx(100.0)
    assert time_left(60.0, 0.5, 0.5) is None
    assert time_left(60.0, None, None) is None


@pytest.mark.parametrize("kind", ["ablation", "search"])
def test_every_file_escapes_what_it_shows(kind: str, request: pytest.FixtureRequest) -> None:
    folder, journal = request.getfixturevalue(kind)
    page = Page(folder, EVIL, {**PAPER, "caption": EVIL})
    page.write(journal, film=True)
    html = (folder / "page.html").read_text()
    assert "<img" not in html
    assert "&lt;img src=x" in html
    assert "<img" not in (folder / "page.md").read_text().replace("\\<img", "")
    assert "There is no video: nothing was recorded of" in html


def test_a_page_that_cannot_be_written_stops_nothing(
    ablation: tuple[Path, Journal], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture
) -> None:
    def full(path: Path, data: bytes) -> None:
        raise RunError(f"{path} could not be written: the disk is full.")

    monkeypatch.setattr("understudy_sweeps.page.write_atomically", full)
    Page(ablation[0], "x").write(ablation[1])
    assert "No page: " in capsys.readouterr().err


# ---------------------------------------------------------------------- the video


def test_tiles_and_their_columns() -> None:
    assert [columns_of(n) for n in range(1, 8)] == [1, 2, 3, 2, 3, 3, 3]


def recorded(folder: Path, **arrays: Any) -> Tile:
    folder.mkdir(parents=True, exist_ok=True)
    np.savez(folder / "recording.npz", **arrays)
    return Tile(folder.name, folder)


@pytest.mark.parametrize(
    "arrays",
    [
        {"x": np.zeros(3)},
        {"control_dt": 0.1, "first_episode": 3},
        {"control_dt": 0.0, "first_episode": 3, "x": np.zeros(3)},
        {"control_dt": 0.1, "first_episode": 3, "x": np.array([{}, 1])},
        {"control_dt": 0.1, "first_episode": 3, "x": np.float64(1)},
        {"control_dt": 0.1, "first_episode": 3, "x": np.zeros(3), "y": np.zeros(2)},
        {"control_dt": 0.1, "first_episode": 3, "x": np.zeros((3, 100))},
    ],
    ids=["no time", "no field", "no step", "objects", "no frames", "lengths", "too large"],
)
def test_recordings_of_strangers_are_data(
    tmp_path: Path, arrays: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", 1000)
    with pytest.raises(RunError, match="the recording of a is damaged or empty"):
        make_film(tmp_path / "film.mp4", [recorded(tmp_path / "a", **arrays)])
    assert not (tmp_path / "film.mp4").exists()


# ---------------------------------------------------------------------- in a browser

QUICK = (
    "num_worlds=16", "learner.rollout_steps=8", "budget.samples=768", "evaluation.every_samples=256",
    "evaluation.episodes=8", "evaluation.final_episodes=8", "evaluation.seconds=1.0",
)  # fmt: skip


@pytest.fixture
def browser() -> Iterator[Any]:
    yield from opened()


def test_the_page_of_an_ablation(browser: Any, tmp_path: Path) -> None:
    """Two variants, three seeds: table, curves and a video that plays, with no network at all."""
    folder = tmp_path / "sweep"
    paper = "+outer_loop.paper={caption: Table 3, values: {curriculum: 0.5}}"
    command = ["sweep", "ablation=miniature/jumping", *QUICK, paper, f"run.dir={folder}"]
    assert main(command) == 0
    context = browser.new_context(offline=True, color_scheme="dark")
    page, asked, errors = context.new_page(), [], []
    page.on("request", lambda request: asked.append(request.url))
    page.on("console", lambda message: errors.append(message.text))
    page.goto((folder / "page.html").as_uri())
    assert page.title() == "miniature/jumping · understudy"
    rows = page.locator("section").first.locator("tr")
    texts = [rows.nth(i).inner_text().split("\t") for i in range(rows.count())]
    assert texts[0][:2] == ["variant", "seeds"]
    assert [row[:2] for row in texts[1:]] == [["curriculum", "3"], ["full_height", "3"]]
    assert texts[1][texts[0].index("paper")] == "0.5"
    assert page.locator("path.series-band").count() >= 8, "two variants in each chart"
    colours = page.locator("path.series").evaluate_all(
        "found => [...new Set(found.map(path => getComputedStyle(path).stroke))]"
    )
    assert len(colours) == 2
    video = page.locator("video")
    video.evaluate("video => video.play()")
    size = video.evaluate("video => [video.videoWidth, video.videoHeight]")
    assert size == [960, 270]
    names = page.locator(".film span")
    assert names.all_inner_texts() == ["curriculum", "full_height"]
    first, second = (names.nth(i).bounding_box() for i in (0, 1))
    assert second["x"] - first["x"] == pytest.approx(video.bounding_box()["width"] / 2, abs=3)
    assert [url for url in asked if not url.startswith(("file:", "data:"))] == []
    assert errors == []
    page.set_viewport_size({"width": 390, "height": 800})
    wide = page.evaluate("document.documentElement.scrollWidth")
    assert wide <= 390, "a telephone shows it without scrolling sideways"


def test_the_page_takes_a_twentieth_of_the_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Written after each of 200 trials of 0.4 s, it made the last ones a fifth slower than the first."""
    now, page, journal = [100.0], Page(tmp_path, "a sweep"), Journal(tmp_path / "journal.jsonl")
    written: list[float] = []

    def write(self: Page, *_: Any, **__: Any) -> None:
        written.append(now[0])
        now[0] += 0.1

    monkeypatch.setattr(Page, "write", write)
    monkeypatch.setattr(time, "monotonic", lambda: now[0])
    for _ in range(50):
        page.keep_up(journal)
        now[0] += 0.4
    assert len(written) == 10
    now[0] += 60.0
    page.keep_up(journal)
    assert len(written) == 11


def test_the_film_is_of_its_recordings_whatever_clocks_say(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """That a film is newer than the journal says nothing where clocks are set."""
    page, drawn = Page(tmp_path, "a sweep"), []
    tiles = [Tile("one", tmp_path / "run")]
    tiles[0].run.mkdir()
    for path in (tiles[0].recording, tmp_path / "film.mp4", tmp_path / "journal.jsonl"):
        path.write_bytes(b"x")
    (tmp_path / "film.json").write_bytes(film_module._identity(tiles))
    monkeypatch.setattr(page_module, "_tiles", lambda results: tiles)
    monkeypatch.setattr(page_module, "make_film", lambda path, tiles: drawn.append(path))
    os.utime(tmp_path / "journal.jsonl", (4e9, 4e9))
    page._draw([])
    assert drawn == []
    os.utime(tmp_path / "film.mp4", (5e9, 5e9))
    os.utime(tiles[0].recording, (1e9, 1e9))
    page._draw([])
    assert drawn == [tmp_path / "film.mp4"]


def test_the_film_is_drawn_once(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    command = [
        "sweep", "ablation=miniature/jumping", *QUICK, "outer_loop.seeds=[0]", f"run.dir={tmp_path}"
    ]  # fmt: skip
    assert main(command) == 0
    film = (tmp_path / "film.mp4").stat().st_mtime_ns
    assert main(command) == 0
    assert (tmp_path / "film.mp4").stat().st_mtime_ns == film
    assert "data:video/mp4" in (tmp_path / "page.html").read_text()


def test_unsound_episodes_have_a_column_where_there_are_some(tmp_path: Path) -> None:
    """In every table; a trial without any has 0 %."""
    journal = Journal(tmp_path / "journal.jsonl")
    for seed in (0, 1):
        add(tmp_path, journal, Trial(f"full-{seed}", variant="full", seed=seed), 0.5)
        wrong = Trial(f"wrong-{seed}", variant="wrong", seed=seed)
        add(tmp_path, journal, wrong, 0.5, unsound=0.25)
    results = Results(tmp_path).of(journal)
    compared = tables.compared(variants_of(results), None)
    at = list(compared.heads).index("unsound")
    assert [row[at] for row in compared.rows] == ["0 % (2 seeds)", "25 % (2 seeds)"]
    trials = tables.trials(results)
    at = list(trials.heads).index("unsound")
    assert [row[at] for row in trials.rows] == ["0 %", "25 %"] * 2
    assert b"unsound" in tables.compared_csv(variants_of(results), None).splitlines()[0]
    sound = [r for r in results if r.trial.variant == "full"]
    assert "unsound" not in tables.compared(variants_of(sound), None).heads
    assert "unsound" not in tables.trials(sound).heads
