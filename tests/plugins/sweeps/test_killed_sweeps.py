"""Sweeps that are killed at random moments end as one that never was, and repeat nothing."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import pytest
from commands import begin
from executors import ENDLESS, SMALL_STOP, iterations, state_of
from worlds import assert_same_state

from understudy.command.cli import main
from understudy.errors import PreemptedError

#: Four trials: the later ones begin from the best of the earlier ones and rise in fidelity, and
#: some are ended early.
SEARCH = (
    "search=miniature/cmfbo",
    "num_worlds=16",
    "learner.rollout_steps=8",
    "budget.samples=1024",
    "evaluation.every_samples=256",
    "evaluation.episodes=8",
    "evaluation.final_episodes=8",
    "evaluation.seconds=2.0",
    "checkpoint.minutes=0",
    "run.video_seconds=0",
)
#: The search of the thesis, with DeepMimic's walk as its task, made small: six trials, of which the last
#: is at full difficulty and begins from an earlier one.
WALK = (
    "search=cmfbo/walk",
    "num_worlds=8",
    "learner.rollout_steps=8",
    "budget.samples=1024",
    "evaluation.every_samples=256",
    "evaluation.episodes=4",
    "evaluation.final_episodes=4",
    "evaluation.seconds=2.0",
    "simulator.threads=1",
    "checkpoint.minutes=0",
    "run.video_seconds=0",
    "outer_loop.parameters={learner.batch_size: {low: 16, high: 64}}",
    "outer_loop.trials=6",
    "outer_loop.initial=3",
    "outer_loop.budget=null",
)


def rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def told(folder: Path) -> list[dict[str, Any]]:
    """The journal, less where it is."""
    found = rows(folder)
    for row in found:
        row.get("report", {}).pop("run", None)
    return found


def kills(process: Any, seconds: float) -> bool:
    """SIGKILL the process after some seconds, unless it has ended; whether it was killed."""
    process.join(seconds)
    if not process.is_alive():
        assert process.exitcode == 0
        return False
    process.kill()
    process.join()
    return True


def check_as_never_killed(folder: Path, straight: Path, trials: int) -> None:
    assert told(folder) == told(straight), "the same trials and reports, each once and in order"
    counts = Counter(r["event"] for r in rows(folder))
    assert counts["asked"] == counts["finished"] == trials
    for key in (f"trial{number}" for number in range(trials)):
        assert_same_state(state_of(straight, key), state_of(folder, key))
        assert iterations(folder, key) == iterations(straight, key)
    assert (folder / "summary.json").read_text() == (straight / "summary.json").read_text()


@pytest.mark.parametrize(
    ("executor", "count"),
    [
        ("in_process", 3),
        ("processes", 3),
        pytest.param("in_process", 10, marks=pytest.mark.slow),
        pytest.param("processes", 10, marks=pytest.mark.slow),
    ],
)
def test_killed_at_random_moments(executor: str, count: int, tmp_path: Path) -> None:
    longer = ["budget.samples=16384"] if count == 10 else []
    check_kills([*SEARCH, *longer], 4, executor, count, tmp_path)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("executor", ["in_process", "processes"])
def test_the_walk_killed_at_random_moments(executor: str, tmp_path: Path) -> None:
    check_kills(WALK, 6, executor, 10, tmp_path)
    asked = [r["trial"] for r in rows(tmp_path / "killed") if r["event"] == "asked"]
    assert asked[-1]["fidelity"] == 1.0
    assert asked[-1]["start"]["trial"] in [t["key"] for t in asked[:-1]]


def check_kills(
    search: Sequence[str], trials: int, executor: str, count: int, folder: Path
) -> None:
    """Each kill is a SIGKILL of a real sweep; one worker, since with several the order in which
    trials end, and with it what a search asks for, is up to the machine."""
    straight, killed = folder / "straight", folder / "killed"
    began = time.monotonic()
    assert main(["sweep", *search, f"run.dir={straight}"]) == 0
    share = (time.monotonic() - began) / count  # so that it is still running at the last kill
    command = ["sweep", *search, f"executor={executor}", f"run.dir={killed}"]
    if executor == "processes":
        command += ["executor.workers=1", "executor.threads=1"]
    moments = random.Random(count)
    for _ in range(count):
        seconds = 0.5 + moments.uniform(0.0, share)
        assert kills(begin(*command), seconds), "it ended before it was killed"
    assert main(command) == 0
    check_as_never_killed(killed, straight, trials)


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
