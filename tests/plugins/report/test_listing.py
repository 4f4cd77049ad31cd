"""``understudy runs``: newest first, with task, result and minutes; it writes nothing."""

from __future__ import annotations

import fcntl
import json
from pathlib import Path
from typing import Any

import pytest

from understudy.command.cli import main
from understudy_report.listing import list_runs


def make(folder: Path, created: str, evaluation: Any = None, **info: Any) -> Path:
    folder.mkdir(parents=True)
    known = {"layout": 3, "config": {"seed": 0, "task": "fake"}, "overrides": [], "sources": {}}
    (folder / "run.json").write_text(json.dumps(known | {"created": created} | info))
    (folder / "metrics.jsonl").write_text('{"samples": 2000, "seconds": 90.0}\n')
    if evaluation is not None:
        (folder / "evaluation.json").write_text(json.dumps(evaluation))
    return folder


def test_newest_first_with_what_came_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    good = {"success_rate": 0.5, "episodes": 128}
    make(Path("runs/old"), "2026-01-01T00:00:00", good, judged=1, overrides=["experiment=x/walk"])
    make(Path("runs/new"), "2026-02-01T00:00:00")
    make(Path("runs/sweep/trials/a/seed0"), "2026-01-15T00:00:00", {"measures": {"d": {"mean": 2}}})
    make(Path("runs/new/renders/again"), "2026-03-01T00:00:00")  # of a run, none of its own
    make(Path("runs/skills/.begun/run"), "2026-03-01T00:00:00")  # by a command that died
    before = sorted(tmp_path.rglob("*"))
    assert main(["runs"]) == 0
    lines = capsys.readouterr().out.splitlines()
    assert [line.split()[0] for line in lines[1:]] == [
        "runs/new",
        "runs/sweep/trials/a/seed0",
        "runs/old",
    ]
    assert "unfinished; not evaluated" in lines[1]
    assert "unfinished; d 2" in lines[2]
    assert lines[3].split() == [
        "runs/old", "x/walk", "50", "%", "of", "128", "succeeded", "2k", "1.5", "2026-01-01", "00:00",
    ]  # fmt: skip
    assert sorted(tmp_path.rglob("*")) == before
    assert main(["runs", "--json"]) == 0
    rows = json.loads(capsys.readouterr().out)
    assert (rows[0]["run"], rows[0]["minutes"]) == ("runs/new", 1.5)


def test_a_run_that_trains_is_said_to(tmp_path: Path) -> None:
    run = make(tmp_path / "a", "2026")
    with open(run / ".lock", "w") as file:
        fcntl.flock(file, fcntl.LOCK_EX)
        assert list_runs([tmp_path])[0][0].state == "training"
    assert list_runs([tmp_path])[0][0].state == "unfinished"


def test_what_cannot_be_listed_is_named(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    make(tmp_path / "a", "2026")
    (tmp_path / "b").mkdir()
    (tmp_path / "b" / "run.json").write_text("{")
    assert main(["runs", str(tmp_path)]) == 0
    said = capsys.readouterr().out
    assert f"Left out: {tmp_path}/b/run.json is damaged" in said
    assert f"{tmp_path}/a  " in said


@pytest.mark.parametrize(
    ("words", "status", "answer"),
    [([], 0, "There is no run in runs."), (["nosuch"], 2, "nosuch is no folder.")],
)
def test_nothing_there(
    words: list[str],
    status: int,
    answer: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["runs", *words]) == status
    said = capsys.readouterr()
    assert answer in said.out + said.err
