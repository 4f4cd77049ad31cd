"""Keeps with a run what led to the first numbers that went wrong, so that it can be repeated."""

from __future__ import annotations

from collections.abc import Callable

from understudy.errors import RunError
from understudy.records import checkpoint
from understudy.records.runs import Run, versions
from understudy.task import State


class Faults:
    """Writes into the ``faults/`` of a run, and tells of it."""

    def __init__(self, run: Run, tell: Callable[[str], None]) -> None:
        self._run, self._tell = run, tell

    def keep(self, name: str, state: State, samples: int) -> None:
        """Write `state`, from which numbers went wrong after `samples`, as the checkpoint `name`."""
        path, run = self._run.path / "faults" / name, self._run
        meta = {"config": run.config, "versions": versions(), "samples": samples}
        try:
            checkpoint.save(path, state, meta)
            self._tell(f"A number is not finite any more; what led to it is in {path}.json.")
        except RunError as error:  # the training can go on without it
            self._tell(f"A number is not finite any more, and {error}")
