"""Searches beside each other: the best value that each has found against the samples it has spent."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from markupsafe import Markup

from understudy import __version__
from understudy.errors import ConfigError
from understudy.folders import write_atomically
from understudy.setup.composition import compose_raw, replaced
from understudy.setup.plugins import installed
from understudy.setup.validation import validate
from understudy_report import words
from understudy_report.charts import Chart, Series, draw_series
from understudy_report.markup import piece
from understudy_report.page import html_page
from understudy_reproduce.tables import PaperTable, variant_name
from understudy_sweeps.curves import legend, mean_curve, style_of
from understudy_sweeps.intervals import mean_of, paired_difference
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import OuterLoop, Report
from understudy_sweeps.page import STYLE
from understudy_sweeps.sweep import sweep
from understudy_sweeps.tables import Table, as_csv, in_markdown, shown_mean
from understudy_sweeps.trial import written

_NOTES = (
    "A search's best value is the highest y (the objective, scaled by eq. 6.5 where the search says so) "
    "among its trials at full fidelity; before the first of those it has none. Where the fidelity is a "
    "budget, a trial that was done before it ended counts: more would not have changed it.",
    "Means over seeds [95 % interval of the mean, Student's t] (seeds with a value); one seed has no "
    "interval. Differences are taken seed by seed: an interval without 0 in it is one that these seeds show.",
    "Bold: the mean over seeds, where all of them have a value; band: its 95 % interval, or least to "
    "greatest of two seeds; thin: each seed.",
)


@dataclass(frozen=True)
class Found:
    """What one search has found by now."""

    seed: int
    #: (n, 2): the samples spent when each trial was finished, and the best value by then; NaN before
    #: there is one.
    curve: np.ndarray
    whole: int = 0  #: trials at full fidelity
    finished: bool = False
    whole_samples: float = 0.0  #: that whole trials cost

    @property
    def spent(self) -> float:
        return float(self.curve[-1, 0]) if len(self.curve) else 0.0

    def best(self, samples: float) -> float | None:
        """By the time `samples` were spent."""
        known = self.curve[(self.curve[:, 0] <= samples) & np.isfinite(self.curve[:, 1])]
        return float(known[-1, 1]) if len(known) else None

    def steps(self, end: float = 0.0) -> np.ndarray:
        """(m, 2): the curve as it is, constant until it jumps, from its first value on; what is finished
        stays at its best up to `end`."""
        known = self.curve[np.isfinite(self.curve[:, 1])]
        if self.finished and len(known) and end > self.spent:
            known = np.vstack([known, [end, known[-1, 1]]])
        before = np.column_stack([known[1:, 0], known[:-1, 1]])
        corners = np.empty((max(2 * len(known) - 1, 0), 2))
        corners[0::2], corners[1::2] = known, before
        return corners


class Comparison:
    """The searches of `table`, each in a folder of its own, ``ROW/COLUMN/seedN`` in `folder`.

    `given` are the command line's overrides, of all of them. A search that is there goes on where it
    stopped; one that is finished stays as it is.
    """

    def __init__(self, name: str, table: PaperTable, folder: Path, given: Sequence[str]) -> None:
        self.name, self.table, self.folder = name, table, folder
        self._given = list(given)
        #: By row, and column or, of a loop of several searches, the name of one: what each seed found.
        self.found: Mapping[tuple[str, str], Sequence[Found]] = {}

    def run(self) -> None:
        """All searches of the first seed, then those of the next."""
        for seed in self.table.seeds:
            for row, column in self._cells():
                sweep(self.overrides_of(row, column, seed))

    def read(self) -> None:
        """What the journals tell by now; of several searches of one loop the best ones come first."""
        found: dict[tuple[str, str], list[Found]] = {}
        for row, column in self._cells():
            several: dict[str, list[Found]] = {}
            for searches in self._read(row, column):
                for name, one in searches.items():
                    several.setdefault(name, []).append(one)
            if set(several) <= {""}:
                found[row, column] = several.get("", [])
                continue
            for name in sorted(several, key=lambda name: -_mean_best(several[name])):
                found[row, name if len(self.table.columns) == 1 else f"{column}, {name}"] = several[
                    name
                ]
        self.found = found

    def _cells(self) -> list[tuple[str, str]]:
        named = self.table.variants()
        pairs = ((row, column) for row in self.table.rows for column in self.table.columns)
        return [pair for pair in pairs if variant_name(*pair) in named]

    def overrides_of(self, row: str, column: str, seed: int) -> list[str]:
        own: list[str] = []
        for more in (self.table.overrides, self.table.rows[row], self.table.columns[column]):
            own = replaced(own, list(more))
        place = self.place_of(row, column, seed)
        return replaced(
            replaced(own, self._given), [f"seed={seed}", f"run.dir={written(str(place))}"]
        )

    def place_of(self, row: str, column: str, seed: int) -> Path:
        return self.folder / row / column / f"seed{seed}"

    def _columns(self, row: str) -> list[str]:
        """What a row compares, in the order of the table's columns where it has those."""
        return [c for r, c in self.found if r == row] or list(self.table.columns)

    def _read(self, row: str, column: str) -> Iterator[dict[str, Found]]:
        chosen = None
        for seed in self.table.seeds:
            journal = Journal.read(self.place_of(row, column, seed) / "journal.jsonl")
            if not journal.finished:
                continue
            if chosen is None:  # seeds change nothing of it
                raw = compose_raw(self.overrides_of(row, column, seed))
                alone = {"outer_loop": raw["outer_loop"]}  # what trains need not be installed here
                chosen = validate(alone, installed().registry).need("outer_loop")
            yield found_by(chosen.build(seed), journal, seed)

    # ------------------------------------------------------------------ what it says

    def headline(self) -> str:
        searches = [one for found in self.found.values() for one in found]
        asked = max(len(self._cells()), len(self.found)) * len(self.table.seeds)
        done = sum(one.finished for one in searches)
        spent = sum(one.spent for one in searches)
        return (
            f"{done} of {asked} searches are finished, {len(searches)} begun; they have spent "
            f"{words.short(spent)} samples together."
        )

    def tables(self) -> Iterator[tuple[str, Table]]:
        """One for each row of the paper's."""
        for row in self.table.rows:
            cells = {c: found for (r, c), found in self.found.items() if r == row and found}
            if cells:
                yield row, _compared(cells)

    def _charts(self, row: str) -> str:
        """The curves of a row's searches in one picture; colours go by what it compares."""
        searches = [one for (r, _), found in self.found.items() if r == row for one in found]
        end, series = max(one.spent for one in searches), []
        for index, column in enumerate(self._columns(row)):
            found = self.found.get((row, column), ())
            curves = [steps for one in found if len(steps := one.steps(end))]
            line, band = mean_curve(curves)
            series.append(Series(line, style_of(index), band, curves))
        return draw_series(Chart(f"{row}: best value at full fidelity", "", dots=True), series, end)

    def text(self) -> str:
        """The tables, for a terminal."""
        parts = [f"{title}\n{table.text()}" for title, table in self.tables()]
        return "\n\n".join([*parts, self.headline()])

    # ------------------------------------------------------------------ files

    def write(self) -> Path:
        """``card.md``, ``card.html``, ``card.csv`` and ``curves.csv``; returns the first."""
        self.read()
        table = self.table
        markdown = [
            f"# {in_markdown(table.title)}",
            in_markdown(f"{table.source}. {self.headline()}"),
            *(f"## {in_markdown(title)}\n\n{t.markdown()}" for title, t in self.tables()),
            *map(in_markdown, _NOTES),
            *(["## Known deviations", "\n".join(f"- {in_markdown(d)}" for d in table.deviations)]
              if table.deviations else []),
            f"`understudy reproduce {self.name}`, understudy {__version__}.",
        ]  # fmt: skip
        sections = [piece("headline", f"{table.source}. {self.headline()}")]
        for title, shown in self.tables():
            charts = f'{legend(self._columns(title))}<div class="pair">{self._charts(title)}</div>'
            sections.append(piece("section", title, Markup(charts + shown.html())))
        sections.append(piece("paragraphs", _NOTES))
        if table.deviations:
            sections.append(piece("section", "Known deviations", piece("items", table.deviations)))
        content = "".join(sections)
        created = time.strftime("%Y-%m-%d %H:%M")
        over = f"understudy reproduce {self.name} · {__version__}"
        files = {
            "card.html": html_page(table.title, over, created, content, STYLE),
            "card.csv": as_csv(self._summary()),
            "curves.csv": as_csv(self._points()),
            "card.md": "\n\n".join(markdown).encode(errors="replace") + b"\n",
        }
        self.folder.mkdir(parents=True, exist_ok=True)
        for name, data in files.items():
            write_atomically(self.folder / name, data)
        return self.folder / "card.md"

    def _summary(self) -> Iterator[list[Any]]:
        yield ["row", "column", "seed", "best", "samples", "trials", "whole_trials", "finished"]
        for (row, column), found in self.found.items():
            for one in found:
                best = one.best(np.inf)
                yield [row, column, one.seed, "" if best is None else best, one.spent,
                       len(one.curve), one.whole, one.finished]  # fmt: skip

    def _points(self) -> Iterator[list[Any]]:
        yield ["row", "column", "seed", "samples", "best"]
        for (row, column), found in self.found.items():
            for one in found:
                for samples, best in one.curve.tolist():
                    yield [row, column, one.seed, samples, best if np.isfinite(best) else ""]


def found_by(loop: OuterLoop, journal: Journal, seed: int) -> dict[str, Found]:
    """What the search `loop` has found, by its `journal`; of a loop of several searches (rows that name their
    ``search``) each by that name, else under "".

    Raises
    ------
    ConfigError
        its summary does not say which trials are whole and what they gave.
    """
    for event in journal.events:
        if isinstance(event, Report):
            loop.tell(event)
        else:
            loop.recall(event)
    rows = loop.summary()
    if not all({"y", "whole"} <= row.keys() for row in rows):
        raise ConfigError(
            f"{type(loop).__name__} does not say what its trials are worth, so it cannot be compared "
            "with other searches. Choose one of `bayes` or `cmfbo`."
        )
    finished = loop.share is not None and loop.share >= 1
    searches: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        searches.setdefault(str(row.get("search", "")), []).append(row)
    return {name: _found(_in_order(own, journal), seed, finished) for name, own in searches.items()}


def _mean_best(found: Sequence[Found]) -> float:
    """Over seeds; those that have none count as nothing."""
    return statistics.fmean(one.best(np.inf) or 0.0 for one in found)


def _in_order(
    rows: Sequence[Mapping[str, Any]], journal: Journal
) -> Iterator[tuple[Mapping[str, Any], float]]:
    """The finished ones of a summary's `rows` as their jobs ended, and the samples of each."""
    by_job: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:  # a candidate of several is part of a job
        by_job.setdefault(str(row.get("job", row.get("trial"))), []).append(row)
    for key, report in journal.finished.items():
        for row in by_job.get(key, ()):
            yield row, float(row["samples"] or 0.0) if "job" in row else report.cost


def _found(rows: Iterator[tuple[Mapping[str, Any], float]], seed: int, finished: bool) -> Found:
    spent, best, whole, at_whole, points = 0.0, np.nan, 0, 0.0, []
    for row, cost in rows:
        spent += cost if row.get("counts", True) else 0.0
        if row["whole"]:
            whole += 1
            at_whole += cost
            if row["y"] is not None:
                best = np.fmax(best, row["y"])
        points.append((spent, best))
    return Found(seed, np.array(points).reshape(-1, 2), whole, finished, at_whole)


def _compared(cells: Mapping[str, Sequence[Found]]) -> Table:
    """A line for each search: its best value when all have spent as much, and in the end. A search
    that still runs is compared once it has spent as much as the others did in the end."""
    searches = [one for found in cells.values() for one in found]
    # some had no trial that could begin
    spent = [one for one in searches if one.spent > 0] or searches
    equal = min(one.spent for one in [s for s in spent if s.finished] or spent)
    name, at_equal = next(iter(cells)), {}
    for column, found in cells.items():
        values = {one.seed: one.best(equal) for one in found if one.spent >= equal}
        at_equal[column] = {seed: v for seed, v in values.items() if v is not None}
    heads = [
        "search",
        f"best value after {words.short(equal)} samples",
        f"against {name}",
        "in the end",
        "samples",
        "of whole trials",
        "trials (at full fidelity)",
    ]
    rows = []
    for column, found in cells.items():
        ends = [one.best(np.inf) for one in found if one.finished]
        there = sum(one.spent >= equal for one in found)
        difference = paired_difference(at_equal[name], at_equal[column])
        rows.append(
            [
                column,
                _counted(list(at_equal[column].values()), there, len(found)),
                shown_mean(None if column == name else difference, sign=True),
                _counted([v for v in ends if v is not None], len(ends), len(found)),
                words.short(statistics.fmean(one.spent for one in found)),
                words.short(statistics.fmean(one.whole_samples for one in found)),
                ", ".join(f"{len(one.curve)} ({one.whole})" for one in found),
            ]
        )
    return Table(heads, rows)


def _counted(values: Sequence[float], there: int, begun: int) -> str:
    """The mean of `values`, which `there` of the `begun` searches could have."""
    parts = [f"{shown_mean(mean_of(values), counted=True)} ({len(values)})"] if values else []
    parts += [f"{there - len(values)} without one"] if there > len(values) else []
    parts += [f"{begun - there} still running"] if begun > there else []
    return "; ".join(parts)
