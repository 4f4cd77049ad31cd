"""Fault 31: the clock is set back by hours, or files are of the future: nothing is lost, nothing lasts less
than no time, and nothing waits for tomorrow."""

from __future__ import annotations

import ast
import gc
import json
import os
import random
import re
import signal
import time
from pathlib import Path
from typing import Any

import pytest
from executors import SMALL_STOP
from worlds import assert_same_state

from understudy.command.cli import main
from understudy.errors import PreemptedError
from understudy.records import checkpoint, runs
from understudy.running.training import Training
from understudy_play.pace import Pace

ROOT = Path(__file__).resolve().parents[2]
COMMAND = (*SMALL_STOP, "run.video_seconds=0")
CLOCKS = ("seconds", "samples_per_second", "collect_share")
DAY = 86400.0


@pytest.fixture
def set_back(monkeypatch: pytest.MonkeyPatch) -> None:
    """The wall's clock goes back by up to two hours whenever somebody looks at it."""
    now, hours, named = [time.time()], random.Random(0), time.strftime

    def look() -> float:
        now[0] -= 7200 * hours.random()
        return now[0]

    def written(pattern: str, *moment: Any) -> str:
        return named(pattern, *(moment or (time.localtime(look()),)))

    monkeypatch.setattr(time, "time", look)
    monkeypatch.setattr(time, "time_ns", lambda: int(look() * 1e9))
    monkeypatch.setattr(time, "strftime", written)


def result(run: Path) -> tuple[Any, ...]:
    rows = [{k: v for k, v in r.items() if k not in CLOCKS} for r in runs.open_run(run).metrics()]
    return rows, json.loads((run / "evaluation.json").read_text())


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("straight") / "run"
    assert main(["train", *COMMAND, f"run.dir={run}"]) == 0
    return run


def stopped_half_way(run: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    iterate = Training.iterate

    def until_third(self: Training) -> dict[str, Any]:
        if self.progress.iteration == 2:
            signal.raise_signal(signal.SIGTERM)
        return iterate(self)

    with monkeypatch.context() as patch:
        patch.setattr(Training, "iterate", until_third)
        assert main(["train", *COMMAND, f"run.dir={run}"]) == PreemptedError.exit_status
    gc.collect()  # the training held its folder: another process would find it free


def into_the_future(folder: Path) -> None:
    for path in (folder, *folder.rglob("*")):
        os.utime(path, (time.time() + DAY, time.time() + DAY))


@pytest.mark.usefixtures("set_back")
def test_a_training_while_the_clock_is_set_back(
    straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    run = tmp_path / "run"
    stopped_half_way(run, monkeypatch)
    assert main(["resume", str(run)]) == 0
    assert result(run) == result(straight)
    one, other = (checkpoint.load_newest(r / "checkpoints")[0] for r in (straight, run))
    assert_same_state(one, other)
    seconds = [row["seconds"] for row in runs.open_run(run).metrics()]
    assert seconds == sorted(seconds)
    assert seconds[0] > 0
    assert all(row["samples_per_second"] > 0 for row in runs.open_run(run).metrics())
    capsys.readouterr()
    assert main(["runs", str(tmp_path)]) == 0
    assert "-" not in capsys.readouterr().out.split("\n")[1].split("  ")[-2]  # minutes


def test_files_of_the_future(
    straight: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run = tmp_path / "run"
    stopped_half_way(run, monkeypatch)
    into_the_future(run)
    assert main(["resume", str(run)]) == 0
    assert result(run) == result(straight)
    before = result(run)
    into_the_future(run)
    assert main(["resume", str(run)]) == 0, "it is finished, and stays so"
    assert result(run) == before


@pytest.mark.usefixtures("set_back")
def test_a_sweep_while_the_clock_is_set_back(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    words = ("sweep", *COMMAND, "outer_loop=grid", "executor=in_process", f"run.dir={folder}")
    assert main([*words, "outer_loop.seeds=[1]"]) == 0
    first = (folder / "trials.csv").read_text()
    into_the_future(folder)
    assert main([*words, "outer_loop.seeds=[1,2]"]) == 0
    second = (folder / "trials.csv").read_text()
    assert second.startswith(first.rstrip("\n")), "what was finished stays, the page tells the rest"
    assert second.count("\n") == first.count("\n") + 1


@pytest.mark.usefixtures("set_back")
def test_what_plays_keeps_its_pace() -> None:
    pace, began = Pace(), time.monotonic()
    for _ in range(5):
        pace.wait(0.02)
    assert 0.08 < time.monotonic() - began < 5.0


def test_nothing_is_measured_by_a_clock_that_can_be_set() -> None:
    """How long something takes, and which of two is newer: neither is asked of the wall's clock."""
    of_files = ("st_mtime", "st_ctime")
    settable = {
        "time.time", "time.time_ns", "datetime.utcnow", "datetime.today", "date.today", "stat.st_mtime",
        "os.path.getmtime", "path.getmtime",
    }  # fmt: skip
    ends, found = {name.rpartition(".")[2] for name in settable}, []
    some = re.compile(rf"\.\s*({'|'.join((*ends, *of_files))})\b")  # else it need not be parsed
    for folder in ("kernel", "plugins"):
        for file in (ROOT / folder).rglob("*.py"):
            text = file.read_text(encoding="utf-8")
            for node in ast.walk(ast.parse(text if some.search(text) else "")):
                if isinstance(node, ast.Attribute) and node.attr in (*ends, *of_files):
                    name = ast.unparse(node)
                    if name in settable or node.attr in of_files:
                        found.append(f"{file.relative_to(ROOT)}:{node.lineno}: {name}")
    assert found == []
