"""Fault 14: a scheduler that stops, kills and requeues a job as it likes: the same run goes on, no row
is lost or doubled, and the budget is that of the whole.

The scheduler here is a loop: it gives a job some time, ends it in the ways that schedulers do, and
starts it again with the same script until that ends with status 0.
"""

from __future__ import annotations

import os
import random
import signal
from collections import Counter
from pathlib import Path
from typing import Any

import pytest
from commands import begin
from executors import SMALL_STOP
from worlds import SMALL, assert_same_state, make_training, resumed

from understudy.command.cli import main
from understudy.errors import PreemptedError
from understudy.records import checkpoint, runs
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK

COMMAND = (
    *SMALL_STOP, "budget.samples=3840", "evaluation.every_samples=640", "run.video_seconds=0",
)  # fmt: skip


def job(run: Path) -> Any:
    """What a job's script does: go on if there is a run, else begin."""
    if (run / "run.json").exists():
        return begin("resume", str(run))
    return begin("train", *COMMAND, f"run.dir={run}")


def give(process: Any, seconds: float, end: str) -> int:
    """Some time, and then the end: its exit code."""
    process.join(seconds)
    if process.is_alive():
        if end == "time limit":  # told first, and killed when the grace is over
            os.kill(process.pid, signal.SIGTERM)
        elif end == "signal before the limit":
            os.kill(process.pid, signal.SIGUSR1)
        else:  # the machine is gone
            os.kill(process.pid, signal.SIGKILL)
        process.join(30)
        assert not process.is_alive()
    return process.exitcode


@pytest.mark.parametrize("requeues", [4, pytest.param(40, marks=pytest.mark.slow)])
def test_requeued_until_it_is_done(requeues: int, tmp_path: Path) -> None:
    straight, run = tmp_path / "straight", tmp_path / "run"
    assert main(["train", *COMMAND, f"run.dir={straight}"]) == 0
    seconds = runs.open_run(straight).metrics()[-1]["seconds"]
    moments, ends = random.Random(requeues), Counter()
    for number in range(requeues):
        end = ("time limit", "signal before the limit", "node failure")[number % 3]
        code = give(job(run), 0.3 + moments.uniform(0, 6 * seconds / requeues), end)
        ends[code] += 1
        if code == 0:
            break
        assert code in (PreemptedError.exit_status, -signal.SIGKILL), code
    while give(job(run), 60.0, "node failure") != 0:
        pass
    rows = runs.open_run(run).metrics()
    assert [row["iteration"] for row in rows] == list(range(1, 31)), "each once, and in order"
    assert rows[-1]["samples"] == 3840, "and not that much since the last start"
    evaluated = [row["samples"] for row in rows if "evaluation/slow" in row]
    assert evaluated == list(range(640, 3841, 640))
    states = [checkpoint.load_newest(folder / "checkpoints")[0] for folder in (straight, run)]
    assert_same_state(*states)
    assert sum(ends.values()) > 1
    assert not list(run.rglob(".*.partial"))


def test_rows_after_the_checkpoint_are_written_anew(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    assert training.run is not None
    for iteration in range(1, 7):
        training.run.append_metrics(training.iterate())
        if iteration == 3:
            training.save()
    training.run.unlock()
    again = resumed(plugins, tmp_path / "run")
    assert again.run is not None
    assert [row["iteration"] for row in again.run.metrics()] == [1, 2, 3]
    again.run.append_metrics(again.iterate())
    assert [row["iteration"] for row in again.run.metrics()] == [1, 2, 3, 4]


def test_rows_that_a_crash_cut_short_are_told_of(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    quick = [*COMMAND, "evaluation.every_samples=null", f"run.dir={run}"]
    assert main(["train", *quick, "budget.samples=256"]) == 0
    with (run / "metrics.jsonl").open("a") as file:
        file.write('\n{"iteration": 2.5}x\n\n{"iteration": 3, "sam')
    assert "damaged" not in capsys.readouterr().err
    assert main(["resume", str(run), "budget.samples=512"]) == 0
    said = capsys.readouterr().err
    assert said.count(f"2 rows are damaged in {run / 'metrics.jsonl'} and left out.") == 1
    kept = (run / "metrics.jsonl.left-out").read_text()
    assert kept == '{"iteration": 2.5}x\n{"iteration": 3, "sam\n', "nothing is lost"
    assert [row["iteration"] for row in runs.open_run(run).metrics()] == [1, 2, 3, 4]
    assert main(["resume", str(run), "budget.samples=640"]) == 0
    assert "damaged" not in capsys.readouterr().err
