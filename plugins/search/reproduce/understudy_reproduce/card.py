"""The reproduction card: the paper's numbers beside ours, what ours cost, and known deviations."""

from __future__ import annotations

import csv
import io
import json
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from markupsafe import Markup

from understudy import __version__
from understudy.folders import read
from understudy.records.checkpoint import write_atomically
from understudy_report import words
from understudy_report.markup import check_markup, piece
from understudy_report.page import html_page
from understudy_report.values import mapping
from understudy_reproduce.tables import Figure, PaperTable, variant_name
from understudy_sweeps.intervals import UNDECIDED, mean_of, verdict
from understudy_sweeps.journal import Journal
from understudy_sweeps.results import SAMPLES, SECONDS, SUCCESS, Result, Results
from understudy_sweeps.tables import Table, in_markdown, shown_mean

_INTERVALS = (
    "Ours are means over seeds [95 % interval of the mean, Student's t] (finished seeds); one seed has no "
    "interval. Samples of a training that never met its criterion say only that it needs more, and "
    "stand apart."
)
_NOTHING = "–"


@dataclass(frozen=True)
class Cell:
    """The trials of one row and column."""

    results: Sequence[Result]

    def values(self, figure: str) -> list[float]:
        """One a finished seed; samples only of those that met their criterion."""
        found = [r for r in self.results if figure != SAMPLES or r.state == "criterion"]
        return [v for r in found if (v := r.figure(figure)) is not None]

    def text(self, figure: Figure) -> str:
        """The mean and its interval, and what it does not say."""
        done = [r for r in self.results if r.ok]
        failed = len([r for r in self.results if r.report is not None and not r.ok])
        parts = []
        values = self.values(figure.of)
        if values:
            kind = SUCCESS if figure.share or figure.of.startswith("success_") else figure.of
            parts.append(f"{shown_mean(mean_of(values), kind, counted=True)} ({len(values)})")
        missed = [r for r in done if figure.of == SAMPLES and r.state != "criterion"]
        if missed:
            least = min(r.figure(SAMPLES) or 0.0 for r in missed)
            parts.append(f"{len(missed)} not within {words.short(least)}")
        if failed:
            parts.append(f"{failed} failed")
        return "; ".join(parts) or _NOTHING

    def verdict(self, figure: Figure, printed: Any) -> str:
        """Whether ours is better than the paper's number; "" where there is none. Samples of a training that
        missed its criterion are more than it had, which decides nothing."""
        if figure.better is None or not isinstance(printed, int | float):
            return ""
        missed = figure.of == SAMPLES and any(r.ok and r.state != "criterion" for r in self.results)
        found = verdict(self.values(figure.of), float(printed), figure.better)
        return UNDECIDED if missed and found else found

    @property
    def minutes(self) -> float:
        """Of training, over all seeds and resumes."""
        return sum(r.figure(SECONDS) or 0.0 for r in self.results) / 60


class Card:
    """The card of `table`, of whatever the sweep in `folder` has finished."""

    def __init__(self, name: str, table: PaperTable, folder: Path) -> None:
        self.name, self.table, self.folder = name, table, folder
        results = Results(folder).of(Journal.read(folder / "journal.jsonl"))
        seeds = set(table.seeds)
        self.cells = {
            (row, column): Cell(
                [
                    r
                    for r in results
                    if r.trial.variant == variant_name(row, column) and r.trial.seed in seeds
                ]
            )
            for row in table.rows
            for column in table.columns
        }

    # ------------------------------------------------------------------ what it says

    def headline(self) -> str:
        trials = [r for cell in self.cells.values() for r in cell.results]
        asked = len(self.table.variants()) * len(self.table.seeds)
        done = sum(r.report is not None for r in trials)
        minutes = sum(cell.minutes for cell in self.cells.values())
        if done == 0:
            return f"0 of {asked} trainings are finished."
        where = ", ".join(sorted({_device(r) for r in trials if r.report})) or "no machine yet"
        return (
            f"{done} of {asked} trainings are finished, in {minutes:.1f} minutes of training on {where} "
            "(building and evaluating not counted)."
        )

    def compared(self) -> Iterator[str]:
        """A line for each cell that the paper has: its number, ours, and the verdict."""
        figure = self.table.figures[0]
        for row, cells in self.table.paper.items():
            for column, number in cells.items():
                cell = self.cells[row, column]
                said = cell.verdict(figure, number)
                ours = cell.text(figure)
                where = row if len(self.table.columns) == 1 else f"{row}, {column}"
                yield f"{where}: paper {_printed(number)}; ours {ours}{f'; {said}' if said else ''}"

    def tables(self) -> Iterator[tuple[str, Table]]:
        """A table for each figure, the paper's first."""
        for figure in self.table.figures:
            printed = self.table.paper if figure is self.table.figures[0] else {}
            yield _title(figure), self._of(figure, printed)
        rows = [
            [row, *(f"{self.cells[row, column].minutes:.1f}" for column in self.table.columns)]
            for row in self.table.rows
        ]
        yield "Minutes of training, all seeds", Table(["", *self.table.columns], rows)

    def _of(self, figure: Figure, printed: Mapping[str, Mapping[str, Any]]) -> Table:
        heads, columns = [""], []
        for column in self.table.columns:
            of_paper = any(column in cells for cells in printed.values())
            own = [f"{column}, paper", f"{column}, ours"] if of_paper else [column]
            heads += [*own, "verdict"] if of_paper and figure.better else own
            columns.append((column, of_paper))
        rows = []
        for row in self.table.rows:
            cells = [row]
            for column, of_paper in columns:
                number = printed.get(row, {}).get(column)
                cells += [_printed(number)] if of_paper else []
                cells.append(self.cells[row, column].text(figure))
                if of_paper and figure.better:
                    cells.append(self.cells[row, column].verdict(figure, number) or _NOTHING)
            rows.append(cells)
        return Table(heads, rows)

    # ------------------------------------------------------------------ files

    def write(self) -> Path:
        """``card.md``, ``card.html`` and ``card.csv`` into the folder; returns the first."""
        table, created = self.table, time.strftime("%Y-%m-%d %H:%M")
        tables = list(self.tables())
        deviations = [*table.deviations]
        markdown = [
            f"# {in_markdown(table.title)}",
            in_markdown(f"{table.source}. {self.headline()}"),
            *(f"## {in_markdown(title)}\n\n{t.markdown()}" for title, t in tables),
            in_markdown(_INTERVALS),
            *(["## Known deviations", "\n".join(f"- {in_markdown(d)}" for d in deviations)] if deviations else []),
            f"`understudy reproduce {self.name}`, understudy {__version__}.",
        ]  # fmt: skip
        sections = [piece("headline", f"{table.source}. {self.headline()}")]
        sections += [piece("section", h, Markup(t.html())) for h, t in tables]
        sections.append(piece("paragraphs", [_INTERVALS]))
        if deviations:
            sections.append(piece("section", "Known deviations", piece("items", deviations)))
        content = "".join(sections)
        check_markup(content)
        over = f"understudy reproduce {self.name} · {__version__}"
        files = {
            "card.html": html_page(table.title, over, created, content),
            "card.csv": self._csv().encode(errors="replace"),
            "card.md": "\n\n".join(markdown).encode(errors="replace") + b"\n",
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            write_atomically(self.folder / name, data)
        return self.folder / "card.md"

    def text(self) -> str:
        """The paper's table with our numbers, for a terminal."""
        title, table = next(self.tables())
        return f"{title}\n{table.text()}"

    def _csv(self) -> str:
        """A line for each row, column and figure, every number in full."""
        file = io.StringIO()
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(
            [
                "row",
                "column",
                "figure",
                "paper",
                "mean",
                "low",
                "high",
                "seeds",
                "trials",
                "minutes",
            ]
        )
        for (row, column), cell in self.cells.items():
            for figure in self.table.figures:
                first = figure is self.table.figures[0]
                printed = self.table.paper.get(row, {}).get(column) if first else None
                mean = mean_of(cell.values(figure.of))
                found = (mean.value, mean.low, mean.high, mean.count) if mean else ("", "", "", 0)
                writer.writerow(
                    [row, column, figure.of, "" if printed is None else printed, *found,
                     len(cell.results), round(cell.minutes, 3)]
                )  # fmt: skip
        return file.getvalue()


def _title(figure: Figure) -> str:
    return figure.title or figure.of.replace("_", " ")


def _printed(number: Any) -> str:
    if number is None:
        return _NOTHING
    return words.short(number) if isinstance(number, int | float) else str(number)


def _device(result: Result) -> str:
    """What the trial ran on."""
    try:
        info = json.loads(read(result.path / "run.json"))
    except (OSError, ValueError, RecursionError):
        info = {}
    return str(mapping(mapping(info).get("config")).get("device") or "an unknown device")
