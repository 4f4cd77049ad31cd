"""The reproduction card: the paper's numbers beside ours, what ours cost, and known deviations."""

from __future__ import annotations

import json
import time
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from markupsafe import Markup

from understudy import __version__
from understudy.folders import read, write_atomically
from understudy_report import words
from understudy_report.markup import piece
from understudy_report.page import html_page
from understudy_report.values import mapping
from understudy_reproduce.records import recorded
from understudy_reproduce.tables import Figure, PaperTable, Printed, variant_name
from understudy_sweeps.intervals import from_below, mean_of, verdict, verdict_between
from understudy_sweeps.journal import Journal
from understudy_sweeps.results import OBJECTIVE, SAMPLES, SECONDS, SUCCESS, Result, Results
from understudy_sweeps.tables import Table, as_csv, in_markdown, shown_mean

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
    less: str = ""  #: how far they fall short of what the table asks for, in words
    samples: float | None = None  #: that the table gives each; None where it does not say

    def ended_early(self) -> list[Result]:
        """The trainings that another limit ended, such as minutes, with less than nine tenths of the table's samples and
        without their criterion."""
        asked = 0.9 * (self.samples or 0.0)
        return [
            r
            for r in self.results
            if r.ok and r.state == "budget" and (r.figure(SAMPLES) or asked) < asked
        ]

    def by_seed(self, figure: str) -> dict[int, float]:
        """As `values`; and of samples, those that a training had that missed its criterion."""
        found = {r.trial.seed or 0: r.figure(figure) for r in self.results}
        return {seed: value for seed, value in found.items() if value is not None}

    def missed(self, figure: str) -> bool:
        """Whether a training did not meet its criterion, so that it needs more samples than it had."""
        return figure == SAMPLES and any(r.ok and r.state != "criterion" for r in self.results)

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
            mean = shown_mean(mean_of(values), _kind(figure), counted=True)
            parts.append(f"{mean} ({len(values)})")
        missed = [r for r in done if figure.of == SAMPLES and r.state != "criterion"]
        if missed:
            least = min(r.figure(SAMPLES) or 0.0 for r in missed)
            parts.append(f"{len(missed)} not within {words.short(least)}")
        early = (
            [] if figure.of == SAMPLES else [r.figure(SAMPLES) or 0.0 for r in self.ended_early()]
        )
        if early and self.samples:
            of = " to ".join(dict.fromkeys(words.short(v) for v in (min(early), max(early))))
            parts.append(f"{len(early)} with {of} of {words.short(self.samples)} samples")
        if failed:
            parts.append(f"{failed} failed")
        return "; ".join(parts) or _NOTHING

    def verdict(self, figure: str, than: float, better: Literal["less", "more"]) -> str:
        """Whether ours is less, or more, `than` a number; "" of none. Samples of a training that missed its criterion count
        as that many, where more would say the same."""
        found = verdict(list(self.by_seed(figure).values()), than, better)
        return from_below(found, better, self.missed(figure))

    def verdict_beside(self, other: Cell, figure: str, better: Literal["less", "more"]) -> str:
        """Whether ours is less, or more, than what the `other` has. What missed its criterion counts with the samples
        that it had, where more would say the same."""
        if self.less != other.less:
            return ""  # trained otherwise
        found = verdict_between(self.by_seed(figure), other.by_seed(figure), better)
        return from_below(found, better, self.missed(figure), other.missed(figure))

    @property
    def minutes(self) -> float | None:
        """Of training, over all seeds and resumes; None where it is not known of any, as of a journal alone."""
        known = [seconds for r in self.results if (seconds := r.figure(SECONDS)) is not None]
        return sum(known) / 60 if known else None


class Card:
    """The card of `table`, of whatever the sweep in `folder` has finished, and, where that lacks a training, the
    folder of `records`."""

    def __init__(
        self, name: str, table: PaperTable, folder: Path, records: Path | None = None
    ) -> None:
        self.name, self.table, self.folder = name, table, folder
        results = Results(folder).of(Journal.read(folder / "journal.jsonl"))
        seeds = set(table.seeds)
        here = [r for r in results if r.trial.seed in seeds]
        known = {} if records is None else recorded(table, records)
        for result in here:  # what was begun here is not hidden by what is recorded
            known.pop(result.trial.key, None)
        self.recorded = {key: record for key, (record, _) in known.items()}
        every = [*here, *(result for _, result in known.values())]
        self.cells = {
            (row, column): self._cell(every, row, column)
            for row in table.rows
            for column in table.columns
        }
        self._by_name = {variant_name(*at): cell for at, cell in self.cells.items()}

    def _cell(self, results: Sequence[Result], row: str, column: str) -> Cell:
        own = [r for r in results if r.trial.variant == variant_name(row, column)]
        less = (self.recorded[k].less for r in own if (k := r.trial.key) in self.recorded)
        said = "; ".join(dict.fromkeys(filter(None, less)))
        return Cell(own, said, None if said else self.table.samples(row, column))

    # ------------------------------------------------------------------ what it says

    def headline(self) -> str:
        trials = [r for cell in self.cells.values() for r in cell.results]
        asked = len(self.table.variants()) * len(self.table.seeds)
        done = sum(r.report is not None for r in trials)
        text = f"{done} of {asked} trainings are finished"
        here = [r for r in trials if r.report and r.path.is_dir()]
        if here:
            minutes = sum(r.figure(SECONDS) or 0.0 for r in here) / 60
            where = ", ".join(sorted({_device(r) for r in here}))
            text += f", in {minutes:.1f} minutes of training on {where} (building and evaluating not counted)"
        if gone := done - len(here):
            text += f"; the run folders of {gone} are not here, so minutes and machine of these are not known"
        return f"{text}."

    def state(self) -> str:
        """How much of the table is finished: ``done``, ``partly``, ``in small``, where all of it falls short of what
        the table asks for, or ``not begun``; and by how many trainings."""
        asked = len(self.table.variants()) * len(self.table.seeds)
        done = {r.trial.key: r for cell in self.cells.values() for r in cell.results if r.ok}
        early = {r.trial.key for cell in self.cells.values() for r in cell.ended_early()}
        small = [
            key
            for key in done
            if key in early or (key in self.recorded and self.recorded[key].less)
        ]
        on_record = len([key for key in done if key in self.recorded])
        what = "searches" if self.table.searches else "trainings"
        short = f", {len(small)} in small" if small else ""
        word = (
            "not begun" if not done
            else "in small" if len(small) == len(done)
            else "done" if len(done) == asked and not small
            else "partly"
        )  # fmt: skip
        return f"{word}: {len(done)} of {asked} {what}, {on_record} of them on record{short}"

    def verdict(self, row: str, column: str) -> str:
        """On what the paper says of a cell; "" where nothing tells, or ours has nothing."""
        one, cell = self.table.printed(row, column), self.cells[row, column]
        figure = self._figure(one).of
        better: Literal["less", "more"] = "more" if one.less is None else "less"
        than = one.more if one.less is None else one.less
        if isinstance(than, str):
            other = self._by_name.get(self.table.other(than, row, column))
            return cell.verdict_beside(other, figure, better) if other else ""
        return "" if than is None else cell.verdict(figure, than, better)

    def verdicts(self) -> Iterator[tuple[str, str, str, str]]:
        """For each cell that the paper or we have: its name, what the paper says, ours, and the verdict."""
        for (row, column), cell in self.cells.items():
            one = self.table.printed(row, column)
            if one.says is not None or cell.results:
                figure = self._figure(one)
                ours = cell.text(figure)
                if one.of and ours != _NOTHING:
                    named = _title(figure)
                    ours = f"{named[:1].lower()}{named[1:]}: {ours}"
                ours += f" ({cell.less})" if cell.less else ""
                name = row if len(self.table.columns) == 1 else f"{row}, {column}"
                yield name, _claimed(one, figure), ours, self.verdict(row, column)

    def _figure(self, one: Printed) -> Figure:
        """The one that is compared: what it names, else the table's first, of searches the best value."""
        named = {figure.of: figure for figure in self.table.figures}
        first = Figure(OBJECTIVE) if self.table.searches else self.table.figures[0]
        return named.get(one.of, Figure(one.of)) if one.of else first

    def what(self) -> str:
        """What the numbers of `compared` are where a line names nothing else, in words."""
        return "Best value" if self.table.searches else _title(self.table.figures[0])

    def compared(self) -> Iterator[str]:
        """A line for each cell that the paper or we have."""
        for where, printed, ours, said in self.verdicts():
            yield f"{where}: paper {printed}; ours {ours}{f'; {said}' if said else ''}"

    def tables(self) -> Iterator[tuple[str, Table]]:
        """A table for each figure, the paper's first."""
        for figure in self.table.figures:
            yield _title(figure), self._of(figure, figure is self.table.figures[0])
        rows = [
            [row, *(_minutes(self.cells[row, column].minutes) for column in self.table.columns)]
            for row in self.table.rows
        ]
        yield "Minutes of training, all seeds", Table(["", *self.table.columns], rows)

    def _of(self, figure: Figure, is_papers: bool) -> Table:
        heads, columns = [""], []
        for column in self.table.columns:
            said = [self.table.printed(row, column) for row in self.table.rows] if is_papers else []
            of_paper = any(one.says is not None for one in said)
            judged = any(one.less is not None or one.more is not None for one in said)
            own = [f"{column}, paper", f"{column}, ours"] if of_paper else [column]
            heads += [*own, "verdict"] if judged else own
            columns.append((column, of_paper, judged))
        rows = []
        for row in self.table.rows:
            cells = [row]
            for column, of_paper, judged in columns:
                cells += (
                    [_printed(self.table.printed(row, column).says, figure)] if of_paper else []
                )
                cells.append(self.cells[row, column].text(figure))
                cells += [self.verdict(row, column) or _NOTHING] if judged else []
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
        over = f"understudy reproduce {self.name} · {__version__}"
        files = {
            "card.html": html_page(table.title, over, created, content),
            "card.csv": self._csv(),
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

    def _csv(self) -> bytes:
        """A line for each row, column and figure, every number in full."""
        heads = "row column figure paper mean low high seeds trials minutes"
        lines: list[list[Any]] = [heads.split()]
        for (row, column), cell in self.cells.items():
            for figure in self.table.figures:
                first = figure is self.table.figures[0]
                printed = self.table.printed(row, column).says if first else None
                mean = mean_of(cell.values(figure.of))
                found = (mean.value, mean.low, mean.high, mean.count) if mean else ("", "", "", 0)
                lines.append(
                    [row, column, figure.of, "" if printed is None else printed, *found,
                     len(cell.results), "" if cell.minutes is None else round(cell.minutes, 3)]
                )  # fmt: skip
        return as_csv(lines)


def _title(figure: Figure) -> str:
    return figure.title or figure.of.replace("_", " ")


def _minutes(value: float | None) -> str:
    return _NOTHING if value is None else f"{value:.1f}"


def _kind(figure: Figure) -> str:
    """What its numbers are shown as."""
    return SUCCESS if figure.share or figure.of.startswith("success_") else figure.of


def _claimed(one: Printed, figure: Figure) -> str:
    """What the paper says; and where that is no number, what is told of ours."""
    beside = {"less than": one.less, "more than": one.more}
    told = [
        f"{way} {_printed(than, figure)}"
        for way, than in beside.items()
        if than not in (None, one.says)
    ]
    return _printed(one.says, figure) + (f" ({told[0]})" if told else "")


def _printed(said: Any, figure: Figure) -> str:
    """What a paper prints of the figure: a number as ours are, or words."""
    if said is None:
        return _NOTHING
    return (
        shown_mean(mean_of([said]), _kind(figure)) if isinstance(said, int | float) else str(said)
    )


def _device(result: Result) -> str:
    """What the trial ran on."""
    try:
        info = json.loads(read(result.path / "run.json"))
    except (OSError, ValueError, RecursionError):
        info = {}
    return str(mapping(mapping(info).get("config")).get("device") or "an unknown device")
