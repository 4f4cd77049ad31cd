"""A reproduction under signals at random instants, given again until it ends: the table of one that never
was stopped."""

from __future__ import annotations

import os
import random
import signal
import time
from pathlib import Path

import pytest
from commands import begin_reproduction
from killed_sweeps import told

from understudy.errors import PreemptedError

TABLE = """
title: How near a point gets
source: A paper, table 1
overrides: [budget.samples=4096, evaluation.every_samples=1024, evaluation.gate=0.0, evaluation.criterion=null,
            checkpoint.minutes=0, run.video_seconds=0]
rows:
  calm: [experiment=miniature/go]
columns:
  small: []
  large: ['policy.hidden=[64, 64]']
figures:
  - {of: distance, title: 'Distance, m'}
  - {of: return}
paper:
  calm: {small: 0.5, large: much nearer}
seeds: [0, 1]
"""
SMALL = ("evaluation.episodes=4", "evaluation.final_episodes=4", "evaluation.seconds=0.5")
STOPPED = PreemptedError.exit_status
SENT = (signal.SIGKILL, signal.SIGTERM, signal.SIGINT)


def ended(process: object) -> int:
    process.join(120)  # type: ignore[attr-defined]
    code = process.exitcode  # type: ignore[attr-defined]
    assert code is not None, "it hangs"
    return code


def card(folder: Path) -> list[str]:
    """The table, less its last column, minutes."""
    return [line.rpartition(",")[0] for line in (folder / "card.csv").read_text().splitlines()]


@pytest.mark.slow
@pytest.mark.parametrize(("count", "seed"), [(4, 0), (20, 1)])
@pytest.mark.timeout(900)
def test_signals_at_random_instants(count: int, seed: int, tmp_path: Path) -> None:
    table, moments = tmp_path / "one.yaml", random.Random(seed)
    table.write_text(TABLE if count < 10 else TABLE.replace("=4096", "=16384"), encoding="utf-8")
    words = ("reproduce", "mine/one", *SMALL)
    began = time.monotonic()
    assert ended(begin_reproduction(table, *words, f"run.dir={tmp_path / 'straight'}")) == 0
    share = (time.monotonic() - began) / count
    stopped, folder = 0, tmp_path / "stopped"
    for number in range(count):
        process = begin_reproduction(table, *words, f"run.dir={folder}")
        process.join(0.4 + moments.uniform(0.0, 2 * share))
        if process.is_alive():
            sent = SENT[number % len(SENT)]
            os.kill(process.pid, sent)
            code = ended(process)
            stopped += code != 0
            # Before our first line a signal has the system's effect, and there is nothing to lose yet.
            assert code in (0, -sent, STOPPED)
        else:
            assert ended(process) == 0
    assert stopped >= 1, "nothing was stopped"
    assert ended(begin_reproduction(table, *words, f"run.dir={folder}")) == 0
    assert told(folder) == told(tmp_path / "straight")
    assert card(folder) == card(tmp_path / "straight")
