"""How far a training is: a live line on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import shlex
import time
from collections.abc import Mapping
from typing import Any

from rich.console import Console
from rich.progress import BarColumn, Progress, TaskID, TextColumn

from understudy.records.observer import RunObserver
from understudy.records.runs import Run

__all__ = ["LiveLine", "clock"]

#: Seconds between lines where there is no terminal.
_PAUSE = 10.0
#: Share of the usual samples before which no time is told from them: learners that first gather are fast at first.
_EARLY = 0.25


class LiveLine:
    """A bar and a note beside it on a terminal, once started; elsewhere there is none."""

    def __init__(self, what: str) -> None:
        self.console = Console(stderr=True, highlight=False)
        self._what = what
        self._bar: Progress | None = None
        self._task = TaskID(0)

    def start(self) -> None:
        if self.console.is_terminal:
            self._bar = Progress(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"),
                console=self.console, transient=True,
            )  # fmt: skip
            self._bar.start()
            self._task = self._bar.add_task(self._what, total=1.0, note="")

    def show(self, share: float, note: str) -> bool:
        """Move the bar to that `share`; returns whether there is one."""
        if self._bar is None:
            return False
        self._bar.update(self._task, completed=share, note=note)
        return True

    def stop(self) -> None:
        if self._bar is not None:
            self._bar.stop()


class ProgressLine(RunObserver):
    """Shows samples, speed, returns, and the time that the budget leaves."""

    def __init__(self) -> None:
        self._line = LiveLine("training")
        self._printed = 0.0
        self._first: Mapping[str, float] | None = None

    def started(self, run: Run) -> None:
        where = shlex.quote(str(run.path))
        text = f"Curves: tensorboard --logdir {where}"
        self._line.console.print(text, soft_wrap=True, markup=False)
        self._line.start()

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        self._first = self._first or row
        done, left = share(run.config["budget"], row, self._first)
        ends = ending(run.config, row, left)
        parts = [
            f"iteration {row['iteration']}",
            f"{row['samples']:,} samples",
            f"{row['samples_per_second']:,.0f}/s",
        ]
        if "episode/return" in row:
            parts.append(f"return {row['episode/return']:.1f}")
            parts.append(f"episode {row['episode/episode_seconds']:.2f} s")
        if stage:
            parts.append(stage)
        if ends:
            parts.append(ends)
        text = " · ".join(parts)
        if not self._line.show(done, text) and time.monotonic() - self._printed > _PAUSE:
            self._printed = time.monotonic()
            self._line.console.print(text, soft_wrap=True)

    def finished(self, run: Run, outcome: str) -> None:
        self._line.stop()


def share(
    budget: Mapping[str, Any], row: Mapping[str, float], first: Mapping[str, float]
) -> tuple[float, float | None]:
    """The share of the budget that is spent, and the seconds left at the speed since the iteration `first`, which compiled."""
    shares, left = [], []
    if budget["samples"]:
        shares.append(row["samples"] / budget["samples"])
        done = row["samples"] - first["samples"]
        if done > 0:
            pace = (row["seconds"] - first["seconds"]) / done
            left.append((budget["samples"] - row["samples"]) * pace)
    if budget["minutes"]:
        shares.append(row["seconds"] / (60 * budget["minutes"]))
        left.append(60 * budget["minutes"] - row["seconds"])
    return min(1.0, max(shares, default=0.0)), max(0.0, min(left)) if left else None


def ending(config: Mapping[str, Any], row: Mapping[str, float], left: float | None) -> str:
    """When it is over, in words: `left` are the seconds that the budget leaves at this speed."""
    criterion = (config.get("evaluation") or {}).get("criterion")
    until = f"until {criterion:.0%} succeed, ".replace("%", " %") if criterion else ""
    usual = config["budget"].get("usual_samples") or 0
    if until and row["samples"] < _EARLY * usual:
        return until.rstrip(", ")
    more = usual - row["samples"]
    seconds = more / max(row["samples_per_second"], 1e-9)
    if until and more > 0 and seconds < (left or seconds + 1):
        return f"{until}usually in {clock(seconds)}"
    return f"{until}at most {clock(left)} left" if left is not None else until.rstrip(", ")


def clock(seconds: float) -> str:
    """Minutes and seconds, with hours where there are any."""
    minutes, rest = divmod(int(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours}:{minutes:02d}:{rest:02d}" if hours else f"{minutes}:{rest:02d}"
