"""How far a training is: a live line on a terminal, a line now and then elsewhere."""

from __future__ import annotations

import contextlib
import io
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Mapping, Sequence
from typing import Any, cast

from rich.console import Console, RenderableType
from rich.progress import BarColumn, Progress, ProgressColumn, Task, TaskID, TextColumn
from rich.text import Text

from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy_report.by_term import ByTerm

__all__ = ["Lines", "LiveLine", "clock"]

#: Seconds between lines where there is no terminal.
_PAUSE = 10.0
#: Characters of a line of the summary at most.
_WIDTH = 120
#: Share of the usual samples before which no time is told from them: learners that first gather are fast at first.
_EARLY = 0.25


class _Bar(Progress):
    """A bar with lines below it."""

    below: Sequence[str] = ()

    def get_renderables(self) -> Iterable[RenderableType]:
        yield from super().get_renderables()
        for line in self.below:
            yield Text(line, no_wrap=True, overflow="ellipsis")


class _Left(ProgressColumn):
    """How long it goes on, which grows less while nothing else is told."""

    def render(self, task: Task) -> Text:
        ends = task.fields["ends"]
        if ends is None:
            return Text()
        left = ends - time.monotonic()
        return Text(f"· about {clock(left)} left" if left > 0 else "· longer than before")


class _Stderr(io.TextIOBase):
    """Standard error, to which nothing is written any more where that fails: its reader or its terminal is gone. Rich
    would end the program, and its standard output with it."""

    def __init__(self) -> None:
        self._stream: Any = getattr(sys.stderr, "rich_proxied_file", sys.stderr)

    @property
    def encoding(self) -> str:  # pyright: ignore[reportIncompatibleVariableOverride]
        return getattr(self._stream, "encoding", "utf-8")

    def writable(self) -> bool:
        return True

    def isatty(self) -> bool:
        return self._stream is not None and self._stream.isatty()

    def write(self, text: str) -> int:
        with contextlib.suppress(OSError, AttributeError):
            self._stream.write(text)
        return len(text)

    def flush(self) -> None:
        with contextlib.suppress(OSError, AttributeError):
            self._stream.flush()


class LiveLine:
    """A bar, a note beside it and lines below it on a terminal, once started; elsewhere there is none."""

    def __init__(self, what: str) -> None:
        self.console = Console(file=cast("Any", _Stderr()), highlight=False)
        self._what = what
        self._bar: _Bar | None = None
        self._task = TaskID(0)

    def start(self) -> None:
        if self.console.is_terminal:
            self._bar = _Bar(
                TextColumn("{task.description}"), BarColumn(), TextColumn("{task.fields[note]}"), _Left(),
                console=self.console, transient=True,
            )  # fmt: skip
            self._bar.start()
            self._task = self._bar.add_task(self._what, total=1.0, note="", ends=None)

    def show(
        self, share: float, note: str, below: Sequence[str] = (), left: float | None = None
    ) -> bool:
        """Move the bar to that `share`; returns whether there is one. About `left` seconds from now it is over."""
        if self._bar is None:
            return False
        self._bar.below = below
        ends = None if left is None else time.monotonic() + left
        self._bar.update(self._task, completed=share, note=note, ends=ends)
        return True

    def stop(self) -> None:
        if self._bar is not None:
            self._bar.stop()


class ProgressLine(RunObserver):
    """Shows samples, speed, returns, and the time that the budget leaves; rewards by term and what ended episodes stand below
    the bar of a terminal, and are printed at the end."""

    def __init__(self) -> None:
        self._line = LiveLine("training")
        self._terms = ByTerm()
        self._printed = 0.0
        self._first: Mapping[str, float] | None = None

    def started(self, run: Run) -> None:
        where = shlex.quote(str(run.path))
        text = f"Curves: tensorboard --logdir {where}"
        self._line.console.print(text, soft_wrap=True, markup=False)
        self._line.start()

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        self._first = self._first or row
        self._terms.add(row)
        done, text = words(run.config, row, self._first, stage)
        console = self._line.console
        below = self._terms.lines(console.width) if console.is_terminal else ()
        if not self._line.show(done, text, below) and time.monotonic() - self._printed > _PAUSE:
            self._printed = time.monotonic()
            self._line.console.print(text, soft_wrap=True)

    def finished(self, run: Run, outcome: str) -> None:
        self._line.stop()
        console = self._line.console
        for text in self._terms.summary(min(console.width, _WIDTH)):
            console.print(text, soft_wrap=True, markup=False)


class Lines(RunObserver):
    """Tells of a long training by a line now and then, as where a sweep has the bar of a terminal."""

    def __init__(self, tell: Callable[[str], None], pause: float = 30.0) -> None:
        self._tell, self._pause = tell, pause
        self._told = time.monotonic()
        self._first: Mapping[str, float] | None = None

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        self._first = self._first or row
        if time.monotonic() - self._told > self._pause:
            self._told = time.monotonic()
            self._tell(f"{run.path.name}: {words(run.config, row, self._first, stage)[1]}")


def words(
    config: Mapping[str, Any], row: Mapping[str, float], first: Mapping[str, float], stage: str
) -> tuple[float, str]:
    """The share of the budget that is spent, and how far the training is; `first` is the row of its first iteration here."""
    done, left = share(config["budget"], row, first)
    ends = ending(config, row, left)
    parts = [
        f"iteration {row['iteration']}",
        f"{row['samples']:,} samples",
        f"{row['samples_per_second']:,.0f}/s",
    ]
    if "episode/return" in row:
        parts.append(f"return {row['episode/return']:.1f}")
        parts.append(f"episode {row['episode/episode_seconds']:.2f} s")
    return done, " · ".join([*parts, *filter(None, (stage, ends))])


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
