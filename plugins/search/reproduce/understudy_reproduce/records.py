"""Trainings of a table that were run elsewhere, as records have them."""

from __future__ import annotations

import contextlib
import csv
import io
import json
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from understudy.errors import FileError
from understudy.folders import read
from understudy_report.values import number
from understudy_reproduce.tables import PaperTable, Record, variant_name
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.results import OBJECTIVE, SAMPLES, Result
from understudy_training.left_out import not_counted


def recorded(table: PaperTable, folder: Path) -> dict[str, tuple[Record, Result]]:
    """By its key in a sweep of the `table`, each finished training of the records in `folder`, and the record that
    it is of. A later record takes the place of an earlier one, and one that falls short of the table counts for cells of
    which no other has anything.

    Raises
    ------
    FileError
        a record is there and cannot be read.
    """
    found: dict[str, tuple[Record, Result]] = {}
    in_order = sorted(table.records.items(), key=lambda item: not item[1].less)
    for name, record in in_order:
        for key, report in _reports(folder / name, record):
            variant, _, seed = key.rpartition("/seed")
            cell = _cell(table, record, variant)
            if cell and seed.isdigit() and int(seed) in table.seeds:
                at = f"{cell}/seed{seed}"
                if not record.less:  # nothing in small beside it
                    found = {
                        k: v
                        for k, v in found.items()
                        if not (v[0].less and v[1].trial.variant == cell)
                    }
                found[at] = (
                    record,
                    Result(Trial(at, variant=cell, seed=int(seed)), report, folder / name),
                )
    return found


def _cell(table: PaperTable, record: Record, variant: str) -> str:
    """The cell that the record calls `variant`; "" if it is none of the table's."""
    named = record.cells.get(variant, variant)
    if "/" not in named and len(table.columns) == 1:  # records name rows alone then
        named = variant_name(named, next(iter(table.columns)))
    return named if named in table.variants() else ""


def _reports(path: Path, record: Record) -> Iterator[tuple[str, Report]]:
    """The final reports of a journal, or one of each row of another file."""
    if not path.exists():
        return
    if not record.by:
        yield from Journal.read(path).finished.items()
        return
    try:
        text = read(path).decode("utf-8-sig", errors="replace")
    except OSError as error:
        raise FileError(f"{path} cannot be read: {error.strerror}.") from error
    lost: list[bytes] = []
    for row in _csv(path, text) if path.suffix == ".csv" else _json(text, lost):
        if any(str(_at(row, at)) != said for at, said in record.where.items()):
            continue
        values = {of: number(_number(_at(row, at))) for of, at in record.values.items()}
        if None in values.values():
            continue
        name = "/".join(str(_at(row, part)) for part in record.by)
        seed = _seed(_at(row, record.seed))
        measures = {of: v for of, v in values.items() if v is not None}
        cost = measures.pop(SAMPLES, 0.0)
        if seed is None or cost < 0.0:
            lost.append(str(row).encode())
            continue
        report = Report(name, "ok", measures.pop(OBJECTIVE, None), measures, cost, "", "criterion")
        yield f"{name}/seed{seed}", report
    not_counted(path, lost)


def _csv(path: Path, text: str) -> list[Any]:
    try:
        return list(csv.DictReader(io.StringIO(text)))
    except csv.Error as error:
        raise FileError(f"{path} is no table of CSV: {error}.") from error


def _json(text: str, lost: list[bytes]) -> Iterator[Any]:
    """What the lines of `text` are as JSON; those that are none go to what is `lost`."""
    for line in text.splitlines():
        try:
            row = json.loads(line)
        except (ValueError, RecursionError):
            lost.append(line.encode())
        else:
            yield row


def _at(row: Any, path: str) -> Any:
    """What `row` has at a dotted path; None if nothing."""
    for part in path.split("."):
        row = row.get(part) if isinstance(row, Mapping) else None
    return row


def _seed(value: Any) -> int | None:
    """The seed that a row has, 0 where it has none; None if that can be none."""
    if value in (None, ""):
        return 0
    found = number(_number(value))
    return int(found) if found is not None and found >= 0.0 and found == int(found) else None


def _number(value: Any) -> Any:
    """A number that a CSV file has as text."""
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            return float(value)
    return value
