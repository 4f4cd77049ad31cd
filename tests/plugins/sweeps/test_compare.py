"""``understudy compare``: which runs are one variant, what differs, how sure it is, what is left."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
from commands import begin_that_stops_writing, kill, wait_for

from understudy.command.cli import main
from understudy.records.runs import open_run
from understudy_sweeps.compare import _difference, differences, variants_among


def make(folder: Path, seed: int = 0, rate: float = 0.5, gamma: float = 0.9, **info: Any) -> Path:
    """A finished run that was never trained."""
    folder.mkdir(parents=True)
    config = {
        "seed": seed,
        "task": "fake",
        "learner": {"gamma": gamma},
        "run": {"dir": str(folder)},
    }
    (folder / "run.json").write_text(
        json.dumps(
            {"layout": 3, "config": config, "overrides": [], "sources": {}, "judged": 10} | info
        )
    )
    rows = [{"samples": 10 * i, "seconds": i, "episode/return": i * rate} for i in (1, 2, 3)]
    (folder / "metrics.jsonl").write_text("".join(json.dumps(row) + "\n" for row in rows))
    low, high = max(0.0, rate - 0.1), min(1.0, rate + 0.1)
    evaluation: Mapping[str, Any] = {
        "episodes": 64, "seconds": 20.0, "success": "no fall", "success_rate": rate,
        "success_rate_95": [low, high], "measures": {"return": {"mean": 3 * rate}},
        "objective": {"name": "success_rate", "value": rate},
    }  # fmt: skip
    (folder / "evaluation.json").write_text(json.dumps(evaluation))
    return folder


def test_runs_that_differ_in_the_seed_alone_are_one_variant(tmp_path: Path) -> None:
    paths = [make(tmp_path / f"a{s}", s) for s in range(3)]
    paths += [make(tmp_path / f"b{s}", s, gamma=0.5) for s in range(3)]
    variants = variants_among([open_run(path) for path in paths])
    assert [(v.name, len(v.results)) for v in variants] == [("a0", 3), ("b0", 3)]


@pytest.mark.parametrize("seed", [[], {}, [[1]], "x", None], ids=str)
def test_a_seed_that_is_none_is_compared_as_it_stands(seed: Any, tmp_path: Path) -> None:
    strange = make(tmp_path / "strange", seed)
    variants = variants_among([open_run(strange), open_run(make(tmp_path / "other", 1))])
    assert [v.name for v in variants] == ["strange", "other"]


def test_two_seeds_alone_are_compared_with_each_other(tmp_path: Path) -> None:
    paths = [make(tmp_path / "x/run", 1), make(tmp_path / "y/run", 2)]
    variants = variants_among([open_run(path) for path in paths])
    assert [v.name for v in variants] == ["x/run", "y/run"]


def test_paired_by_seed(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every seed gains 0.1, 0.2 or 0.3, whatever it began with: the mean is 20 points."""
    words = []
    for seed, (a, b) in enumerate([(0.1, 0.2), (0.5, 0.7), (0.6, 0.9)]):
        words += [str(make(tmp_path / f"a{seed}", seed, a))]
        words += [str(make(tmp_path / f"b{seed}", seed, b, gamma=0.5))]
    page = tmp_path / "page.html"
    assert main(["compare", *words, "--page", str(page), "--no-film"]) == 0
    said = capsys.readouterr().out
    assert "+20 points [-4.84, +44.8]" in said
    assert "learner.gamma  0.9  0.5" in said
    html = page.read_text()
    assert "+20 points [-4.84, +44.8]" in html
    assert html.count('class="series"') >= 4  # two in the legend, two curves at least
    assert str(tmp_path) not in html.replace("trial", "").split("<h2>Runs")[0]


def test_what_differs_by_digest(tmp_path: Path) -> None:
    a = make(tmp_path / "a", code={"ppo": "0" * 64}, inputs={"motion.file": {"0/c.npz": "a" * 64}})
    b = make(tmp_path / "b", code={"ppo": "1" * 64}, inputs={"motion.file": {"0/c.npz": "b" * 64}})
    found = differences([open_run(a), open_run(b)])
    assert found == {
        "What differs in the configuration": [],
        "What differs in the code and the machine": [["code of ppo", "0" * 12, "1" * 12]],
        "What differs in the data": [["file of motion.file", "a" * 12, "b" * 12]],
    }


def test_newcombe() -> None:
    """The example of Newcombe (1998), table II (a): 56/70 against 48/80, method 10: 0.0524 to 0.3339."""
    from understudy_reinforcement.evaluation import wilson_interval

    first = {"success_rate": 48 / 80, "success_rate_95": list(wilson_interval(48 / 80, 80))}
    second = {"success_rate": 56 / 70, "success_rate_95": list(wilson_interval(56 / 70, 70))}
    assert _difference(first, second) == pytest.approx((0.2, 0.0524, 0.3339), abs=1e-4)


def test_judged_otherwise_is_said(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    a, b = make(tmp_path / "a"), make(tmp_path / "b", gamma=0.5)
    text = (b / "evaluation.json").read_text().replace('"no fall"', '"no fall, inside a bound"')
    (b / "evaluation.json").write_text(text)
    assert main(["compare", str(a), str(b), "--page", str(tmp_path / "p.html"), "--no-film"]) == 0
    assert (
        "Not judged alike, a success: no fall | no fall, inside a bound." in capsys.readouterr().out
    )


@pytest.mark.parametrize(
    ("words", "answer"),
    [
        (["a"], "A comparison is of two runs or more"),
        (["a", "./a"], "A comparison is of two runs or more"),
        (["a", "nosuch"], "nosuch is no run folder"),
        (["a", "b", "--page", "there.html"], "there.html is there already. Name another file"),
    ],
)
def test_refused(
    words: list[str],
    answer: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    make(Path("a"))
    make(Path("b"), gamma=0.5)
    Path("there.html").write_text("mine")
    assert main(["compare", *words]) == 2
    assert answer in capsys.readouterr().err
    assert Path("there.html").read_text() == "mine"


def test_names_of_strangers_are_text(tmp_path: Path) -> None:
    evil = "<img src=x onerror=alert(1)>"
    a, b = make(tmp_path / "a", sources={"motion": {evil: evil}}), make(tmp_path / evil)
    assert main(["compare", str(a), str(b), "--page", str(tmp_path / "p.html"), "--no-film"]) == 0
    assert "<img" not in (tmp_path / "p.html").read_text()


def test_killed_it_leaves_what_was_there(tmp_path: Path) -> None:
    a, b = make(tmp_path / "a"), make(tmp_path / "b", gamma=0.5)
    page = tmp_path / "p.html"
    page.write_text("mine")
    before = {p: p.read_bytes() for p in tmp_path.rglob("*") if p.is_file()}
    mark = tmp_path / "written"
    words = ("compare", str(a), str(b), "--page", str(page), "--overwrite", "--no-film")
    process = begin_that_stops_writing(mark, *words)
    wait_for(process, mark)
    kill(process)
    assert {p: p.read_bytes() for p in before} == before
