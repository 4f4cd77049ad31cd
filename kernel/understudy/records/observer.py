"""Who watches a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from understudy.records.recording import Recording
    from understudy.records.runs import Run

__all__ = ["RunObserver"]


class RunObserver:
    """Watches a run; every method may be left out. Observers draw no random numbers."""

    def started(self, run: Run) -> None: ...

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        """An iteration's `row` of metrics is written; `stage` is where the job stands, in words."""

    def finished(self, run: Run, outcome: str) -> None: ...

    def evaluated(self, run: Run, tell: Callable[[str], None]) -> None:
        """The last evaluation was made anew, and nothing else: pictures are as they were."""

    def judged(self, run: Run, recording: Recording | None, tell: Callable[[str], None]) -> None:
        """The last evaluation is in the folder, and the `recording` of it if there is something to
        see; `tell` takes messages."""
