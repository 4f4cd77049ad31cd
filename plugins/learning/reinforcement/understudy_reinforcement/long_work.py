"""Progress of work without rows of metrics, such as an evaluation: a line now and then if it takes long."""

from __future__ import annotations

import time
from collections.abc import Callable

from understudy import distributed
from understudy.command.command import tell

__all__ = ["LongWork"]

#: Seconds until the first line, and at least between two.
_PAUSE = 10.0
#: Lines become rarer: after one, this share of the time so far passes at least.
_RARER = 0.25


class LongWork:
    """Work called `what`, reported only by process 0, after every `pause` seconds."""

    def __init__(
        self, what: str, pause: float = _PAUSE, say: Callable[[str], None] | None = None
    ) -> None:
        self._what, self._say, self._pause = what, say, pause
        self._began = time.monotonic()
        self._told = self._began
        self._first: tuple[float, float] | None = None  #: when what share was done

    def done(self, share: float) -> None:
        """`share` of it is done; prints a line if it is time for one."""
        left, now = self.left(share), time.monotonic()
        if now - self._told < max(self._pause, _RARER * (now - self._began)) or share >= 1:
            return
        self._told = now
        if distributed.rank() == 0:
            (self._say or tell)(f"{self._what}: {share:.0%} done{left}.".replace("%", " %"))

    def left(self, share: float) -> str:
        """The time that is left, in words, from the speed after the first part, which may have included compiling; "" if that is
        not known yet, or too short to mention."""
        now = time.monotonic()
        first, before = self._first = self._first or (now, share)
        if share <= before or now - self._began < self._pause:
            return ""
        seconds = (now - first) / (share - before) * max(0.0, 1.0 - share)
        time_left = f"{seconds:.0f} s" if seconds < 100 else f"{seconds / 60:.0f} min"
        return f", about {time_left} left"
