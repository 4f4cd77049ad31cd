"""Real time, for pages that show what is simulated."""

from __future__ import annotations

import time

#: s: so much that was lost is made up for, not more.
_LATE = 0.1


class Pace:
    """Lets steps begin as far from each other as they are told to last."""

    def __init__(self) -> None:
        self._due = time.monotonic()

    def wait(self, seconds: float) -> None:
        """Until `seconds` after the last one ended, of the clock."""
        self._due = max(self._due + seconds, time.monotonic() - _LATE)
        time.sleep(max(0.0, self._due - time.monotonic()))
