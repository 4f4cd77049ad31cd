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
    is_csv = path.suffix == ".csv"
    for row in csv.DictReader(io.StringIO(text)) if is_csv else map(_json, text.splitlines()):
        if any(str(_at(row, at)) != said for at, said in record.where.items()):
            continue
        values = {of: number(_number(_at(row, at))) for of, at in record.values.items()}
        seed = _number(_at(row, record.seed))
        name = "/".join(str(_at(row, part)) for part in record.by)
        if None not in values.values():
            measures = {of: v for of, v in values.items() if v is not None}
            cost = measures.pop(SAMPLES, 0.0)
            report = Report(
                name, "ok", measures.pop(OBJECTIVE, None), measures, cost, "", "criterion"
            )
            yield f"{name}/seed{int(seed or 0)}", report


def _json(line: str) -> Any:
    with contextlib.suppress(ValueError, RecursionError):
        return json.loads(line)
    return {}


def _at(row: Any, path: str) -> Any:
    """What `row` has at a dotted path; None if nothing."""
    for part in path.split("."):
        row = row.get(part) if isinstance(row, Mapping) else None
    return row


def _number(value: Any) -> Any:
    """A number that a CSV file has as text."""
    if isinstance(value, str):
        with contextlib.suppress(ValueError):
            return float(value)
    return value
