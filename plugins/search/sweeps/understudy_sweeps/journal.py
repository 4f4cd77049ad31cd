"""The state of a sweep: what was asked and told, in order, on disk.

A row of ``journal.jsonl`` is written when a trial is asked for, when it reports, and when it is finished, and is on
the disk before anything follows from it.
"""

from __future__ import annotations

import dataclasses
import json
import math
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import quote

from understudy.errors import ConfigError, RunError
from understudy.folders import read, sync, write_atomically
from understudy.setup.composition import refuse_resolvers
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.trial import folder_of
from understudy_training.left_out import leave_out, not_counted

__all__ = ["Journal"]

_MOST = 2**30  #: bytes of a journal


@dataclass
class Journal:
    """The journal of a sweep. It has one writer at a time, the holder of the folder's lock."""

    path: Path
    events: list[Trial | Report] = field(default_factory=list)

    @classmethod
    def open(cls, path: Path) -> Journal:
        """The journal at `path`. A row that a crash cut short, or that another version wrote, is left out, kept in a file
        beside it, and reported."""
        journal, lost = cls._of(path)
        lost += journal._forget_strangers()
        leave_out(path, lost, ": what such a row told of is done again")
        rows = "".join(_row(event) for event in journal.events).encode()
        if not path.exists() or read(path, _MOST) != rows:
            write_atomically(path, rows)
        return journal

    def _forget_strangers(self) -> list[bytes]:
        """Leave out what follows from no row that is left, of which a loop could make nothing: reports of trials that were
        not asked for before or are finished, and second requests for one; their rows."""
        known, finished = set[str](), set[str]()
        kept, rows = list[Trial | Report](), list[bytes]()
        for event in self.events:
            if isinstance(event, Trial) is (event.key in known) or event.key in finished:
                rows.append(_row(event).encode())
                continue
            kept.append(event)
            if isinstance(event, Trial):
                known.add(event.key)
            elif event.final:
                finished.add(event.key)
        self.events = kept
        return rows

    @classmethod
    def read(cls, path: Path) -> Journal:
        """As :meth:`open`, but changes nothing; rows that are not a journal's are left out and reported, too.

        Raises
        ------
        RunError
            if it cannot be read.
        """
        journal, lost = cls._of(path)
        not_counted(path, lost)
        return journal

    @classmethod
    def _of(cls, path: Path) -> tuple[Journal, list[bytes]]:
        """The journal at `path`, and the rows that are not a journal's; errors as of :meth:`read`."""
        journal, lost = cls(path), list[bytes]()
        try:
            lines = read(path, _MOST).splitlines()
        except FileNotFoundError:
            return journal, lost
        except OSError as error:
            raise RunError(f"{path} cannot be read: {error.strerror}.") from error
        for line in lines:
            try:
                row = json.loads(line.decode(errors="replace"))
                asked = row["event"] == "asked"
                event = trial_of(row["trial"]) if asked else _report(row["report"])
                if isinstance(event, Trial):
                    refuse_resolvers(event.overrides, "A journal")
                journal.events.append(event)
            except (
                ArithmeticError, ValueError, TypeError, LookupError, AttributeError, RecursionError, ConfigError,
            ):  # fmt: skip
                lost.append(line)
        return journal, lost

    @property
    def asked(self) -> list[Trial]:
        return [event for event in self.events if isinstance(event, Trial)]

    @property
    def finished(self) -> dict[str, Report]:
        """By trial, the final report; of two, the first, which a sweep that continues takes, too."""
        found: dict[str, Report] = {}
        for event in self.events:
            if isinstance(event, Report) and event.final:
                found.setdefault(event.key, event)
        return found

    def move(self, folder: str) -> None:
        """Take `folder` as that of the sweep, to which its runs may have been copied from elsewhere: every trial's run is
        in it, whatever the journal says, and what trials were asked to take from a run in the folder before they take
        from this one; in the file as well."""
        runs = {event.key: folder_of(event.key, folder) for event in self.events}
        before = {
            str(Path(event.run).parent)
            for event in self.events
            if isinstance(event, Report) and Path(event.run).name == runs[event.key].name
        } - {folder, "."}
        # Only where a trial's run follows: a folder may be called as a group of options is (experiment=dressing/shirt).
        old, names = (
            "|".join(map(re.escape, sorted(found, key=len, reverse=True)))
            for found in (before, {run.name for run in runs.values()})
        )
        inside = re.compile(rf"(?<![\w./~-])(?:{old})(?=/(?:{names})(?![\w.~%-]))")

        def here(found: Any) -> Any:
            if isinstance(found, str):
                return inside.sub(lambda _: folder, found) if before else found
            if isinstance(found, Mapping):
                return {key: here(value) for key, value in found.items()}
            return tuple(map(here, found)) if isinstance(found, tuple) else found

        def moved(event: Trial | Report) -> Trial | Report:
            if isinstance(event, Report):
                run = str(runs[event.key]) if event.run else ""
                return dataclasses.replace(event, run=run)
            return dataclasses.replace(
                event,
                overrides=here(event.overrides),
                start=here(event.start),
                initial_states=here(event.initial_states),
            )

        if (events := [*map(moved, self.events)]) != self.events:
            self.events = events
            write_atomically(self.path, "".join(map(_row, events)).encode())

    def ask(self, trial: Trial) -> None:
        if any(trial.key == other.key for other in self.asked):
            raise ConfigError(
                f"The outer loop asks for trial '{trial.key}' twice. If rows of {self.path} were left out, mend it by "
                f"{self.path.name}.left-out; or give run.dir another folder."
            )
        refuse_resolvers(trial.overrides, f"Trial '{trial.key}'")  # no journal has such
        self._write(trial)

    def tell(self, report: Report) -> None:
        self._write(report)

    def _write(self, event: Trial | Report) -> None:
        try:
            with open(self.path, "a", encoding="utf-8") as file:
                file.write(_row(event))
                file.flush()
                sync(file.fileno())
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
        report = dataclasses.asdict(event)
        # of what no episode measured; JSON has no NaN, and a row that has one is none to other programs
        report["measures"] = {k: None if math.isnan(v) else v for k, v in event.measures.items()}
        row = {"event": kind, "report": report}
    return json.dumps(row) + "\n"


def trial_of(row: Mapping[str, Any]) -> Trial:
    """The trial whose fields `row` has, as JSON brought them.

    Raises
    ------
    TypeError, ValueError, OverflowError, LookupError
        if they are no trial's.
    """
    trial = Trial(**{**row, "overrides": tuple(row["overrides"])})
    _check_name(trial.key)
    _check(str, trial.variant, *trial.overrides)
    _check(str | None, trial.initial_states)
    _check(Mapping | None, trial.start)
    _check(int | None, trial.seed)
    _check_finite(trial.point.values())
    _check_finite([] if trial.fidelity is None else [trial.fidelity])
    return trial


def _report(row: Mapping[str, Any]) -> Report:
    report = Report(**row)
    measures = {k: math.nan if v is None else v for k, v in report.measures.items()}
    report = dataclasses.replace(report, measures=measures)
    _check_name(report.key)
    _check(str, report.status, report.run, report.outcome)
    _check_numbers(report.measures.values())
    _check_numbers([] if report.objective is None else [report.objective])
    _check_finite([report.cost])
    if report.cost < 0.0:
        raise ValueError(f"{report.cost} samples")
    return report


def _check(kind: Any, *values: Any) -> None:
    for value in values:
        if not isinstance(value, kind):
            raise TypeError(f"{value!r}")


def _check_name(key: Any) -> None:
    """Check that a trial's name can be that of a folder."""
    _check(str, key)
    if not 0 < len(quote(key, safe="")) < 250:
        raise ValueError(key)


def _check_numbers(values: Iterable[Any]) -> None:
    for value in values:
        _check(int | float, value)
        if isinstance(value, bool):
            raise TypeError(f"{value!r}")
        float(value)  # too large an integer has none


def _check_finite(values: Iterable[Any]) -> None:
    _check_numbers(values := list(values))
    if not all(map(math.isfinite, values)):
        raise ValueError(f"{values}")
