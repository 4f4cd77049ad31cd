"""Sweeps that are killed at random moments, compared with one that never was."""

from __future__ import annotations

import json
import random
import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from commands import begin
from executors import iterations, state_of
from worlds import assert_same_state

from understudy.command.cli import main


def rows(folder: Path) -> list[dict[str, Any]]:
    return [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]


def told(folder: Path) -> list[dict[str, Any]]:
    """The journal, less where it is."""
    found = rows(folder)
    for row in found:
        row.get("report", {}).pop("run", None)
    return found


def done(folder: Path) -> int:
    """Iterations of all trials so far."""
    return sum(len(path.read_bytes().splitlines()) for path in folder.glob("*/metrics.jsonl"))


def kills(process: Any, folder: Path, more: int, seconds: float) -> bool:
    """SIGKILL the process some `seconds` after so many `more` iterations, unless it has ended; whether it was killed."""
    until, deadline = done(folder) + more, time.monotonic() + 120
    while process.is_alive() and done(folder) < until:
        assert time.monotonic() < deadline
        time.sleep(0.01)
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


def never_killed(search: Sequence[str], folder: Path) -> Path:
    """`folder` with the sweep, which ran to its end at once."""
    assert main(["sweep", *search, f"run.dir={folder}"]) == 0
    return folder


def check_kills(
    search: Sequence[str], trials: int, executor: str, count: int, straight: Path, killed: Path
) -> None:
    """Kill the sweep `count` times, go on in `killed`, and compare with one that never was, `straight`.

    Each kill is a SIGKILL of a real sweep; one worker, since with several the order in which
    trials end, and with it what a search asks for, is up to the machine.
    """
    share = done(straight) // (count + 1)  # so that it is still running at the last kill
    command = ["sweep", *search, f"executor={executor}", f"run.dir={killed}"]
    if executor == "processes":
        command += ["executor.workers=1", "executor.threads=1"]
    moments = random.Random(count)
    for _ in range(count):
        more, seconds = moments.randint(0, share), moments.uniform(0.0, 0.1)
        assert kills(begin(*command), killed, more, seconds), "it ended before it was killed"
    assert done(killed) > 0, "it was killed before it began"
    assert main(command) == 0
    check_as_never_killed(killed, straight, trials)
