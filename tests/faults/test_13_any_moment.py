"""Fault 13: a stop signal at any moment of a command's life, start-up and the drawing of the video
included: the run is complete, or ends as if it had never been stopped."""

from __future__ import annotations

import contextlib
import json
import os
import pty
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
from commands import begin_code
from executors import SMALL_STOP
from worlds import assert_same_state, child_environment

from understudy.command import cli, command
from understudy.command.cli import main
from understudy.records import checkpoint, runs
from understudy.signals import StopRequest

#: Says when Python has come to our first line, which signals cannot be expected to know earlier.
CODE = "import sys; from understudy.command.cli import main; print('here', flush=True); sys.exit(main())"
COMMAND = [sys.executable, "-c", CODE]
CLOCKS = ("seconds", "samples_per_second", "collect_share")


def start(*arguments: str, **more: Any) -> subprocess.Popen[str]:
    """A command that imports all it needs itself, as users' do."""
    child = subprocess.Popen(
        [*COMMAND, *arguments], env=child_environment(), text=True,
        preexec_fn=lambda: signal.signal(signal.SIGHUP, signal.SIG_DFL),  # these tests may run under nohup
        **{"stdout": subprocess.PIPE, "stderr": subprocess.PIPE, **more},
    )  # fmt: skip
    if child.stdout is not None:
        assert child.stdout.readline() == "here\n"
    return child


@contextlib.contextmanager
def forked(*arguments: str) -> Iterator[tuple[Any, Callable[[], str]]]:
    """The same command where all is imported already; and what it says on standard error."""
    with tempfile.TemporaryDirectory() as folder:
        errors = Path(folder) / "errors"
        process = begin_code(CODE, *arguments, cwd=Path(), out=Path(os.devnull), err=errors)
        yield process, errors.read_text


def found(run: Path) -> tuple[Any, ...]:
    """What a complete run must have in common with the one that was never stopped."""
    opened = runs.open_run(run)
    metrics = [{k: v for k, v in row.items() if k not in CLOCKS} for row in opened.metrics()]
    assert [row["iteration"] for row in metrics] == list(range(1, len(metrics) + 1))
    assert (run / "report.html").exists()
    assert (run / "video.mp4").exists()
    evaluation = json.loads((run / "evaluation.json").read_text())
    return metrics, evaluation, (run / "recording.npz").read_bytes()


def check_stopped(run: Path, status: int, sent: list[signal.Signals], errors: str) -> str:
    """What is left of a command that was sent the signals at one moment; where it was stopped."""
    assert not list(run.rglob(".*.partial"))
    if status == 0:
        return "ended"
    assert status == 75, errors
    last = errors.strip().splitlines()[-1]
    assert last.startswith(tuple(f"understudy: Stopped by {s.name}" for s in sent)), errors
    assert "Traceback" not in errors
    if not run.exists():
        assert last.endswith(". Give the same command again.")
        return "start-up"
    assert last.endswith(f" Continue with `understudy resume {run}`.")
    if "everything is saved" not in last:
        return "judging" if (run / "metrics.jsonl").exists() else "start-up"
    return "loop"


def wait_for(path: Path) -> float:
    """Until it is there; how long that took."""
    began = time.monotonic()
    while not path.exists():
        assert time.monotonic() < began + 60
        time.sleep(0.002)
    return time.monotonic() - began


#: How many signals, and the seed of their moments; the slow ones are a hundred together.
SIGNALS = [(6, 0), *(pytest.param(25, seed, marks=pytest.mark.slow) for seed in range(1, 5))]


@pytest.mark.parametrize(("count", "seed"), SIGNALS)
@pytest.mark.timeout(1800)  # 25 trainings, most of them twice
def test_any_moment(
    count: int, seed: int, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    command = ("train", *SMALL_STOP)
    straight, moments, where = tmp_path / "straight", random.Random(seed), {}
    child = start(*command, f"run.dir={tmp_path / 'first'}")
    started = wait_for(tmp_path / "first/run.json")
    child.kill()
    child.communicate()
    with forked(*command, f"run.dir={straight}") as (process, said):
        wait_for(straight / "run.json")
        began = time.monotonic()
        process.join()
        life = time.monotonic() - began
        assert said().count("Evaluation at 256") == 1
    expected, (state, *_) = found(straight), checkpoint.load_newest(straight / "checkpoints")
    for i in range(count):
        run, sent = tmp_path / f"{i}", [StopRequest.SIGNALS[i % 4]]
        words = (*command, f"run.dir={run}")
        if i % 3 == 0:
            sent.append(signal.SIGTERM)  # a second one does no harm
        if i // 4 % 4 == 0:  # three of four fall into what comes after start-up
            child = start(*words)
            time.sleep(started * moments.random())
            for number in sent:
                child.send_signal(number)
            _, errors = child.communicate(timeout=60)
            status = child.returncode
        else:
            with forked(*words) as (process, said):
                wait_for(run / "run.json")
                time.sleep(life * moments.random())
                for number in sent:
                    with contextlib.suppress(ProcessLookupError):  # it was sooner done
                        os.kill(process.pid, number)
                process.join(60)
                status, errors = process.exitcode, said()
        stage = check_stopped(run, status, sent, errors)
        where[stage] = where.get(stage, 0) + 1
        if status != 0:
            again = ("resume", str(run)) if run.exists() else (*command, f"run.dir={run}")
            assert main(again) == 0
        assert found(run) == expected
        assert_same_state(checkpoint.load_newest(run / "checkpoints")[0], state)
    with capsys.disabled():
        print(f"\n{count} signals: {where}")


def test_a_closed_terminal(tmp_path: Path) -> None:
    """SIGHUP, and nothing more can be printed."""
    run, (ours, theirs) = tmp_path / "run", pty.openpty()
    child = start(
        "train", *SMALL_STOP, "budget.samples=100000000", f"run.dir={run}",
        stdin=theirs, stdout=theirs, stderr=theirs, start_new_session=True,
    )  # fmt: skip
    os.close(theirs)
    wait_for(run / "metrics.jsonl")
    os.close(ours)
    child.send_signal(signal.SIGHUP)
    assert child.wait(timeout=30) == 75
    last = runs.open_run(run).metrics()[-1]["iteration"]
    assert int(checkpoint.newest(run / "checkpoints")[0].name) in (last, last + 1)


def test_nohup_is_kept() -> None:
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with StopRequest() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert stop.received is None
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def stop_inside(noted: list[int | None]) -> None:
    """What is noted inside is seen further inside; nobody acts upon it, so it goes on outside."""
    with StopRequest(at_once=True):
        with StopRequest() as inner:
            signal.raise_signal(signal.SIGUSR1)
            signal.raise_signal(signal.SIGTERM)
            noted.append(inner.received)
            with StopRequest() as innermost:
                noted.append(innermost.received)
        noted.append(0)


def test_requests_nest() -> None:
    before, noted = [signal.getsignal(number) for number in StopRequest.SIGNALS], []
    with pytest.raises(KeyboardInterrupt, match="SIGUSR1"):
        stop_inside(noted)
    assert noted == [signal.SIGUSR1, signal.SIGUSR1]
    assert [signal.getsignal(number) for number in StopRequest.SIGNALS] == before


def test_what_a_library_makes_of_it(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """An interrupted import, say, which ends with an error of its own."""

    def interrupted(arguments: list[str]) -> int:
        try:
            signal.raise_signal(signal.SIGHUP)
        except KeyboardInterrupt:
            raise ImportError("cannot load module more than once per process") from None
        return 0

    monkeypatch.setattr(cli, "_run", interrupted)
    before = signal.signal(signal.SIGHUP, signal.SIG_DFL)  # these tests may run under nohup
    try:
        assert main(["train"]) == 75
    finally:
        signal.signal(signal.SIGHUP, before)
    assert capsys.readouterr().err == (
        "understudy: Stopped by SIGHUP. Give the same command again.\n"
    )


class Gone:
    """Standard error of a terminal that was closed."""

    def write(self, text: str) -> int:
        raise OSError(5, "Input/output error")

    flush = write


def test_when_nothing_can_be_printed(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    """Neither what a training tells nor why a command ends ends it otherwise."""
    monkeypatch.setattr(sys, "stderr", Gone())
    command.tell("Evaluation at 256 samples.")
    assert main(["resume", str(tmp_path / "nowhere")]) == 2
