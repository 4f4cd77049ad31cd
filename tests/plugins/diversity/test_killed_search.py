"""A diversity search that is killed ten times at random moments goes on where it was."""

from __future__ import annotations

import json
import random
import time
from pathlib import Path
from typing import Any

import pytest
from commands import begin, kill
from executors import iterations, state_of
from worlds import assert_same_state

from understudy.command.cli import main

#: Seven trials; the last five are where a model chose, by both of its rules, and those that make no
#: progress are ended early.
SEARCH = (
    "search=diversity/vault",
    "budget.samples=32768",
    "evaluation.every_samples=4096",
    "evaluation.episodes=4",
    "evaluation.final_episodes=4",
    "checkpoint.minutes=0",
    "run.video_seconds=0",
    "outer_loop.trials=7",
    "outer_loop.explore=2",
    "outer_loop.exploit=2",
    "outer_loop.success=0.0",
    "outer_loop.stalled={figure: height, samples: 4096}",
)
KEYS = [f"trial{number}" for number in range(7)]


def told(folder: Path) -> list[dict[str, Any]]:
    """The journal, less where it is."""
    found = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    for row in found:
        row.get("report", {}).pop("run", None)
    return found


@pytest.mark.slow
@pytest.mark.timeout(900)
def test_killed_ten_times(tmp_path: Path) -> None:
    """Each kill is a SIGKILL of a real search in a process of its own; trials, points, early ends,
    weights and the summary are those of one that was never killed."""
    straight, folder = tmp_path / "straight", tmp_path / "killed"
    began = time.monotonic()
    assert main(["sweep", *SEARCH, f"run.dir={straight}"]) == 0
    share = (time.monotonic() - began) / 10  # so that it is still running at the last kill
    outcomes = [r["report"]["outcome"] for r in told(straight) if r["event"] == "finished"]
    assert "stopped" in outcomes, "this search shows nothing of early ends"
    command = ["sweep", *SEARCH, f"run.dir={folder}"]
    moments = random.Random(10)
    for _ in range(10):
        process = begin(*command)
        process.join(0.5 + moments.uniform(0.0, share))
        assert process.is_alive(), "it ended before it was killed"
        kill(process)
    assert main(command) == 0
    assert told(folder) == told(straight), "the same trials and reports, each once and in order"
    for key in KEYS:
        assert_same_state(state_of(straight, key), state_of(folder, key))
        assert iterations(folder, key) == iterations(straight, key)
    assert (folder / "summary.json").read_text() == (straight / "summary.json").read_text()
