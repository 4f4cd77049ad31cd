"""Who watches a run."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from understudy.records.recording import Recording
    from understudy.records.runs import Run

__all__ = ["RunObserver"]


class RunObserver:
    """Watches a run; no method has to be defined. Observers draw no random numbers."""

    def started(self, run: Run) -> None: ...

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        """An iteration's `row` of metrics was written; `stage` says how far the job is."""

    def finished(self, run: Run, outcome: str) -> None: ...

    def evaluated(self, run: Run, tell: Callable[[str], None]) -> None:
        """The last evaluation was repeated, and nothing else: pictures stay as they are."""

    def judged(self, run: Run, recording: Recording | None, tell: Callable[[str], None]) -> None:
        """The last evaluation is in the folder, with a `recording` if there is something to see;
        `tell` takes messages."""
