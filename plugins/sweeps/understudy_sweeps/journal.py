"""What was asked and told, in order, and on disk: the state of a sweep.

A row of ``journal.jsonl`` is written when a trial is asked for, when it reports, and when it is
finished, and is on the disk before anything follows from it.
"""

from __future__ import annotations

import dataclasses
import json
import os
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from understudy.errors import ConfigError, RunError
from understudy.records.checkpoint import write_atomically
from understudy.running.trials import Report, Trial


@dataclass
class Journal:
    """One writer at a time: whoever holds the lock of the sweep's folder."""

    path: Path
    events: list[Trial | Report] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> Journal:
        """The journal at `path`; a row cut short by a crash is left out."""
        journal = cls.read(path)
        rows = "".join(_row(event) for event in journal.events).encode()
        if not path.exists() or path.read_bytes() != rows:
            write_atomically(path, rows)
        return journal

    @classmethod
    def read(cls, path: Path) -> Journal:
        """As :meth:`open`, changing nothing."""
        journal = cls(path)
        if path.exists():
            for line in path.read_text(encoding="utf-8", errors="replace").splitlines():
                try:
                    row = json.loads(line)
                    asked = row["event"] == "asked"
                    found = trial_of(row["trial"]) if asked else Report(**row["report"])
                except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
                    continue
                journal.events.append(found)
        return journal

    @property
    def asked(self) -> list[Trial]:
        return [event for event in self.events if isinstance(event, Trial)]

    @property
    def finished(self) -> dict[str, Report]:
        """The final reports, by trial."""
        return {e.key: e for e in self.events if isinstance(e, Report) and e.final}

    def ask(self, trial: Trial) -> None:
        if any(trial.key == other.key for other in self.asked):
            raise ConfigError(f"The outer loop asks for trial '{trial.key}' twice.")
        self._write(trial)

    def tell(self, report: Report) -> None:
        self._write(report)

    def _write(self, event: Trial | Report) -> None:
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(_row(event))
                file.flush()
                os.fsync(file.fileno())
        except OSError as error:
            raise RunError(
                f"{self.path} could not be written: {error.strerror}. Make room and repeat the "
                "command: what is finished is not run again."
            ) from error
        self.events.append(event)


def _row(event: Trial | Report) -> str:
    if isinstance(event, Trial):
        row = {"event": "asked", "trial": dataclasses.asdict(event)}
    else:
        kind = "finished" if event.final else "reported"
        row = {"event": kind, "report": dataclasses.asdict(event)}
    return json.dumps(row) + "\n"


def trial_of(row: Mapping[str, Any]) -> Trial:
    """The trial whose fields `row` has, as JSON brought them."""
    return Trial(**{**row, "overrides": tuple(row["overrides"])})
