"""``understudy runs``: the run folders that there are, newest first."""

from __future__ import annotations

import argparse
import fcntl
import json
import os
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

from understudy.command.command import Command
from understudy.errors import FileError, RunError, shown
from understudy.records import runs
from understudy.records.runs import Run
from understudy_report import words
from understudy_report.page import name_of
from understudy_report.values import mapping, number, own_evaluation

#: How far below a folder runs are looked for: a sweep's trials are ``SWEEP/trials/VARIANT/seed0``.
_DEPTH = 4


@dataclass(frozen=True)
class Listed:
    """A run folder in a line."""

    run: str
    task: str  #: the experiment, else the task
    seed: Any
    created: str  #: ISO 8601
    state: str  #: ``training``, ``finished``, or ``unfinished``
    result: str  #: of its last evaluation as it was trained
    samples: float | None
    minutes: float | None  #: of training


class ListRuns(Command):
    """Looks through folders for runs; writes nothing."""

    example = "understudy runs"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "folder",
            nargs="*",
            type=Path,
            help="where to look for runs, folders within included (runs)",
        )
        parser.add_argument("--json", action="store_true", help="print JSON, for programs")

    def run(self, options: argparse.Namespace) -> int:
        folders = options.folder or [Path("runs")]
        for folder in folders:
            if options.folder and not folder.is_dir():
                raise FileError(f"{folder} is no folder. Name one that holds runs.")
        found, broken = list_runs(folders)
        if options.json:
            print(json.dumps([asdict(row) for row in found], indent=1))
            return 0
        if not found:
            where = ", ".join(map(str, folders))
            print(f"There is no run in {where}. Name another folder: understudy runs FOLDER")
        rows = [_cells(row) for row in found]
        heads = ("run", "task", "result", "samples", "minutes", "began")
        widths = [max(map(len, column)) for column in zip(heads, *rows, strict=True)]
        for row in [heads, *rows] if rows else []:
            cells = (f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True))
            print("  ".join(cells).rstrip())
        for why in broken:
            print(shown(f"Left out: {why}"))
        return 0


def list_runs(folders: Sequence[Path]) -> tuple[list[Listed], list[str]]:
    """The runs in `folders` and below, newest first, and why others cannot be listed."""
    found, broken, seen = [], [], set[str]()
    for folder in folders:
        for path in _run_folders(folder, _DEPTH):
            if (real := os.path.realpath(path)) in seen:
                continue
            seen.add(real)
            try:
                found.append(_listed(runs.open_run(path)))
            except RunError as error:
                broken.append(str(error))
    return sorted(found, key=lambda row: (row.created, row.run), reverse=True), broken


def _run_folders(folder: Path, depth: int) -> Iterator[Path]:
    """`folder` if it is a run, else those in it; links, hidden folders and what a run holds are not followed."""
    if os.path.lexists(folder / "run.json"):
        yield folder
    elif depth:
        try:
            inside = sorted(
                entry.path
                for entry in os.scandir(folder)
                if entry.is_dir(follow_symlinks=False) and not entry.name.startswith(".")
            )
        except OSError:
            return
        for path in inside:
            yield from _run_folders(Path(path), depth - 1)


def _listed(run: Run) -> Listed:
    rows = run.metrics()
    ends = {
        key: next((n for row in rows[::-1] if (n := number(row.get(key))) is not None), None)
        for key in ("samples", "seconds")
    }
    seconds = ends["seconds"]
    state = "unfinished" if rows and run.judged() is None else "finished"
    return Listed(
        str(run.path),
        name_of(run),
        mapping(run.config).get("seed"),
        words.text(run.info.get("created", "")),
        "training" if _held(run) else state,
        _result(run),
        ends["samples"],
        None if seconds is None else seconds / 60,
    )


def _held(run: Run) -> bool:
    """Whether a process trains in it now; the lock file is not made where there is none."""
    try:
        handle = os.open(run.path / ".lock", os.O_RDONLY | os.O_NOFOLLOW | os.O_NONBLOCK)
    except OSError:
        return False
    try:
        fcntl.flock(handle, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except BlockingIOError:
        return True
    except OSError:
        return False
    finally:
        os.close(handle)
    return False


def _result(run: Run) -> str:
    evaluation = own_evaluation(run)
    rate = number(evaluation.get("success_rate"))
    episodes = number(evaluation.get("episodes"))
    if rate is not None and episodes is not None:
        return f"{words.share(rate)} of {episodes:.0f} succeeded"
    objective = mapping(evaluation.get("objective"))
    value = number(objective.get("value"))
    if value is not None:
        return f"{words.text(objective.get('name', 'objective'))} {words.short(value)}"
    for name, measure in mapping(evaluation.get("measures")).items():
        mean = number(mapping(measure).get("mean"))
        if name != "return" and mean is not None:
            return f"{words.text(name)} {words.short(mean)}"
    return "not evaluated"


def _cells(row: Listed) -> tuple[str, ...]:
    seed = "" if row.seed in (None, 0) else f" seed={words.text(row.seed)}"
    state = "" if row.state == "finished" else f"{row.state}; "
    cells = (
        row.run,
        row.task + seed,
        state + row.result,
        "–" if row.samples is None else words.short(row.samples),
        "–" if row.minutes is None else f"{row.minutes:.{1 if row.minutes >= 1 else 2}f}",
        row.created[:16].replace("T", " "),
    )
    return tuple("".join(c for c in cell if c.isprintable()) for cell in cells)
