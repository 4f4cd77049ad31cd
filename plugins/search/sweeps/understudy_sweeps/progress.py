"""How far a sweep is: a live line on a terminal, a line for each finished trial elsewhere."""

from __future__ import annotations

import time
from collections.abc import Collection, Sequence
from pathlib import Path

from understudy_report.progress import LiveLine, clock
from understudy_report.values import Row
from understudy_sweeps.journal import Journal
from understudy_sweeps.results import Result, best_of, told


class Progress:
    """Trials done, running and failed, a search's best so far, and the time left.

    The time left follows from the share of the outer loop that this process has done since it began. If trials are not
    `alike`, that would not predict those to come.
    """

    def __init__(self, plan: Collection[str], alike: bool = True) -> None:
        self._alike = alike
        self._line = LiveLine("sweep")
        self._plan = plan  #: keys of all trials; none if they are not known
        self._began: tuple[float, float | None] | None = None
        self._told = ""

    def __enter__(self) -> Progress:
        self._line.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._line.stop()

    def show(
        self, journal: Journal, share: float | None, running: int, summary: Sequence[Row] = ()
    ) -> None:
        now = time.monotonic()
        if self._began is None:
            self._began = (now, share)
        text = describe(journal, self._plan, running, summary)
        left = (
            time_left(now - self._began[0], self._began[1], share)
            if self._alike and running
            else None
        )
        if not self._line.show(share or 0.0, text, left=left) and text != self._told:
            note = text if left is None else f"{text} · about {clock(left)} left"
            self._line.console.print(note, soft_wrap=True)
        self._told = text


def describe(
    journal: Journal, plan: Collection[str], running: int, summary: Sequence[Row] = ()
) -> str:
    """How far the sweep is, in words; `summary` are the outer loop's rows.

    Trials that are not of the `plan`, which earlier calls of the sweep asked for, do not count."""
    finished = {k: report for k, report in journal.finished.items() if not plan or k in plan}
    failed = sum(report.status != "ok" for report in finished.values())
    done = f"{len(finished)} of {len(plan)}" if plan else str(len(finished))
    parts = [f"{done} done", f"{running} running"]
    if failed:
        parts.append(f"{failed} failed")
    # Variants are not ranked: what is asked of them may be least where it is best.
    asked = [Result(t, finished.get(t.key), Path()) for t in journal.asked if not t.variant]
    if (best := best_of(told(asked, summary))) is not None:
        parts.append(f"best {best.worth:.3g} ({best.trial.key})")
    return " · ".join(parts)


def time_left(elapsed: float, before: float | None, share: float | None) -> float | None:
    """Seconds until the share is 1, if it went from `before` to `share` in `elapsed` seconds."""
    if before is None or share is None or share <= before:
        return None
    return elapsed * (1.0 - share) / (share - before)
