"""Sweeps that are killed at random moments end as one that never was, and repeat nothing."""

from __future__ import annotations

import functools
import os
import signal
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest
from commands import begin
from executors import ENDLESS, SMALL_STOP, iterations
from killed_sweeps import check_kills, never_killed, rows

from understudy.command.cli import main
from understudy.errors import PreemptedError

#: Four trials: the later ones begin from the best of the earlier ones and rise in fidelity, and
#: some are ended early.
SEARCH = (
    "search=miniature/cmfbo",
    "num_worlds=16",
    "learner.rollout_steps=8",
    "budget.samples=768",
    "evaluation.every_samples=256",
    "evaluation.episodes=8",
    "evaluation.final_episodes=8",
    "evaluation.seconds=2.0",
    "checkpoint.minutes=0",
    "run.video_seconds=0",
)


@pytest.fixture(scope="module")
def straight(tmp_path_factory: pytest.TempPathFactory) -> Callable[..., Path]:
    """Of a search's words: the folder of a sweep that was never killed, which is only read."""

    @functools.cache
    def made(*search: str) -> Path:
        return never_killed(search, tmp_path_factory.mktemp("straight") / "sweep")

    return made


@pytest.mark.parametrize(
    ("executor", "count"),
    [
        ("in_process", 3),
        ("processes", 3),
        pytest.param("in_process", 10, marks=pytest.mark.slow),
        pytest.param("processes", 10, marks=pytest.mark.slow),
    ],
)
def test_killed_at_random_moments(
    executor: str, count: int, straight: Callable[..., Path], tmp_path: Path
) -> None:
    longer = ["budget.samples=16384"] if count == 10 else []
    search = [*SEARCH, *longer]
    check_kills(search, 4, executor, count, straight(*search), tmp_path / "killed")


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
@pytest.mark.parametrize("executor", ["in_process", "processes"])
def test_told_to_stop(
    executor: str,
    number: signal.Signals,
    tmp_path: Path,
) -> None:
    """Trials are saved, and the exit status says to start it again."""
    process = begin(
        "sweep", *SMALL_STOP, *ENDLESS, "checkpoint.minutes=1000", "outer_loop=grid",
        f"executor={executor}", f"run.dir={tmp_path}",
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while len(iterations(tmp_path, "base/seed0")) < 3:
        assert time.monotonic() < deadline
        assert process.is_alive()
        time.sleep(0.02)
    os.kill(process.pid, number)
    process.join(60)
    assert process.exitcode == PreemptedError.exit_status
    done = iterations(tmp_path, "base/seed0")
    saved = sorted(p.stem for p in tmp_path.glob("base%2Fseed0/checkpoints/*.json"))
    assert int(saved[-1]) == done[-1] >= 3
    assert [r["event"] for r in rows(tmp_path)] == ["asked"]


def test_the_sentence_after_a_stop(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    from understudy.running.training import Training

    iterate = Training.iterate

    def interrupted(self: Training) -> dict[str, Any]:
        os.kill(os.getpid(), signal.SIGINT)
        return iterate(self)

    monkeypatch.setattr(Training, "iterate", interrupted)
    command = ["sweep", *SMALL_STOP, "outer_loop=grid", "executor=in_process"]
    assert main([*command, f"run.dir={tmp_path}"]) == 75
    last = capsys.readouterr().err.splitlines()[-1]
    assert last == (
        "understudy: Stopped by SIGINT; finished trials, and the last checkpoints of the others, are "
        f"in {tmp_path}. Give the same command again to go on."
    )
