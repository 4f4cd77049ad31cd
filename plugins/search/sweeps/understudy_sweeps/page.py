"""The pages of a sweep, written again after every finished trial.

``page.html`` is self-contained and readable offline; ``page.md`` is the same without pictures, and ``table.csv`` and
``trials.csv`` have every digit.
"""

from __future__ import annotations

import base64
import math
import time
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from typing import Any

from markupsafe import Markup

from understudy import __version__
from understudy.command.command import tell
from understudy.errors import UnderstudyError, said
from understudy.folders import read, write_atomically
from understudy.setup.config import Experiment
from understudy_report.markup import piece
from understudy_report.page import html_page
from understudy_report.values import Row, mapping
from understudy_sweeps import search, tables
from understudy_sweeps.curves import learning_curves, legend, style_of
from understudy_sweeps.film import Tile, columns_of, make_film, shows
from understudy_sweeps.journal import Journal
from understudy_sweeps.results import Result, Results, Variant, best_of, objective_of, variants_of
from understudy_sweeps.tables import Table

__all__ = ["STYLE", "SweepPage"]

#: CSS of all that a sweep draws, beside the report's.
STYLE = (Path(__file__).parent / "page.css").read_text(encoding="utf-8")
_INTERVALS = (
    "Mean over seeds [95 % interval of the mean, Student's t]; one seed or two have none, and no width "
    "means that the seeds agreed, not that the value is certain."
)
_PAIRED = (
    "The last column is the mean difference to {first}, seed by seed, in {objective}: an interval "
    "without 0 in it is a difference that these seeds show."
)
_EPISODES = "Success of a single trial is [95 % interval over its episodes, Wilson]."
_CURVES = (
    "Bold: the mean over seeds, as far as all of them have come; band: its 95 % interval, or least to "
    "greatest of two seeds; thin: each seed."
)

#: So many times as long as the page took to write it is left as it is.
_REST = 19.0


class SweepPage(ABC):
    """A further page of a sweep, by any plugin: a component of kind ``sweep_page``, made without arguments."""

    @abstractmethod
    def write(
        self, folder: Path, title: str, experiment: Experiment, journal: Journal
    ) -> Path | None:
        """Write the page into the finished sweep's `folder`; its path, or None if this sweep, whose
        configuration is `experiment`, has nothing for it."""


class Page:
    """Writes the files of the sweep in `folder`; `paper` are the published numbers, if there are."""

    def __init__(self, folder: Path, title: str, paper: Mapping[str, Any] | None = None) -> None:
        self.folder, self._title, self._paper = folder, title, paper
        self._results = Results(folder)
        self._film: tuple[Sequence[Tile], str] | None = None  #: and why there is none
        self._rest = -math.inf  #: s, of the clock: until then :meth:`keep_up` writes nothing

    @property
    def path(self) -> Path:
        return self.folder / "page.html"

    def write(self, journal: Journal, summary: Sequence[Row] = (), *, film: bool = False) -> None:
        """Write all files, from what is known now and the outer loop's rows; with `film` also the video, which takes a while. An
        error in writing is reported, and the sweep continues."""
        results = self._results.of(journal, summary)
        try:
            if film and results:
                self._draw(results)
            if results:
                self._write(results)
        except UnderstudyError as error:
            tell(f"No page: {error}")
        except Exception as error:  # what is shown may come from any plugin
            tell(f"No page: {said(error)}")

    def keep_up(self, journal: Journal, summary: Sequence[Row] = ()) -> None:
        """:meth:`write`, but for at most a twentieth of the time: with hundreds of trials it takes ever longer, and trials may
        take seconds."""
        if (began := time.monotonic()) >= self._rest:
            self.write(journal, summary)
            ended = time.monotonic()
            self._rest = ended + _REST * (ended - began)

    def more(self, journal: Journal, experiment: Experiment) -> list[Path]:
        """Write the pages of other plugins, which are components of kind ``sweep_page``; returns their paths. If one fails, it is
        named, and the others are written."""
        registry, found = experiment.registry, []
        for name in registry.names("sweep_page"):
            try:
                page: SweepPage = registry.find("sweep_page", name).factory()
                path = page.write(self.folder, self._title, experiment, journal)
            except Exception as error:  # it comes from any plugin
                tell(f"No {name}: {said(error)}")
                continue
            found += [path] if path is not None else []
        return found

    def table(self, journal: Journal, summary: Sequence[Row] = ()) -> str:
        """The main table as text."""
        results = self._results.of(journal, summary)
        return self._main(results, variants_of(results)).text() if results else "No trial yet."

    def _main(self, results: Sequence[Result], variants: Sequence[Variant]) -> Table:
        return tables.compared(variants, self._paper) if variants else tables.trials(results)

    # ------------------------------------------------------------------ the video

    def _draw(self, results: Sequence[Result]) -> None:
        tiles = _tiles(results)
        reason = ""
        if shows(self.folder / "film.mp4", tiles):
            self._film = tiles, reason
            return
        if any(tile.recording.exists() for tile in tiles):
            tell("Drawing the video …")
        try:
            make_film(self.folder / "film.mp4", tiles)
        except UnderstudyError as error:
            reason = str(error)
        except Exception as error:  # a scene may come from any plugin
            reason = f"{type(error).__name__}: {error}"
        self._film = tiles, reason.rstrip(".")

    def _video(self) -> str:
        if self._film is None:
            return "<p>The video is drawn when all trials are finished.</p>"
        tiles, reason = self._film
        if reason:
            return piece("failed", f"There is no video: {reason}.")
        return film_html(self.folder / "film.mp4", tiles)

    # ------------------------------------------------------------------ the files

    def _write(self, results: Sequence[Result]) -> None:
        variants = variants_of(results)
        headline = _headline(results, variants)
        sections = self._of_variants(variants, results) if variants else self._of_search(results)
        failed = [[r.trial.key, r.report.status] for r in results if r.report and not r.ok]
        if failed:
            sections.append(Section("What failed", table=Table(["trial", "why"], failed)))
        content = "".join([piece("headline", headline), *(s.html() for s in sections)])
        created = time.strftime("%Y-%m-%d %H:%M")
        over = f"understudy sweep · {__version__}"
        title = tables.in_markdown(self._title)
        markdown = [f"# {title}", tables.in_markdown(headline), *(s.markdown() for s in sections)]
        files = {
            "page.html": html_page(self._title, over, created, content, STYLE),
            "page.md": "\n\n".join(filter(None, markdown)).encode(errors="replace") + b"\n",
            "trials.csv": tables.trials_csv(results),
        }
        if variants:
            files["table.csv"] = tables.compared_csv(variants, self._paper)
        for name, data in files.items():
            write_atomically(self.folder / name, data)

    def _of_variants(self, variants: Sequence[Variant], results: Sequence[Result]) -> list[Section]:
        notes = [_INTERVALS]
        if len(variants) > 1:
            objective = objective_of(results)
            notes.append(_PAIRED.format(first=variants[0].name, objective=objective))
        notes += _published(self._paper, variants)
        compared = tables.compared(variants, self._paper)
        sections = [
            Section("Comparison", table=compared, notes=notes),
            Section("Side by side", self._video()),
        ]
        sections += learning_section(variants)
        measures = tables.all_measures(variants)
        if len(measures.rows) > 1:
            sections.append(Section("All measures", table=measures))
        trials = tables.trials(results)
        return [*sections, Section("Trials", table=trials, notes=[_EPISODES])]

    def _of_search(self, results: Sequence[Result]) -> list[Section]:
        return [
            Section("Search", search.charts(results, objective_of(results))),
            Section("Trials, the best first", table=tables.trials(results)),
            Section("The best", self._video()),
        ]


def learning_section(variants: Sequence[Variant]) -> list[Section]:
    """The curves of all variants in common charts; None without curves."""
    curves = "".join(
        f'<h3>{heading}</h3><div class="charts">{charts}</div>'
        for heading, charts in learning_curves(variants).items()
    )
    names = legend([v.name for v in variants])
    return [Section("Learning", names + curves, notes=[_CURVES])] if curves else []


def film_html(film: Path, tiles: Sequence[Tile]) -> str:
    """The video `film` of `tiles` within the page, each under its name."""
    columns = columns_of(len(tiles))
    rows = -(-len(tiles) // columns)
    names = "".join(
        f'<span style="left:{100 * (i % columns) / columns:.2f}%;'
        f'top:{100 * (i // columns) / rows:.2f}%;{style_of(tile.index)}">{escape(tile.name)}</span>'
        for i, tile in enumerate(tiles)
    )
    data = base64.b64encode(read(film)).decode()
    return (
        '<div class="card"><div class="film"><video autoplay muted loop controls playsinline '
        f'src="data:video/mp4;base64,{data}"></video>{names}</div></div>'
    )


@dataclass(frozen=True)
class Section:
    """A part of the page: pictures, which are HTML, a table, and what they mean."""

    title: str
    pictures: str = ""
    table: Table | None = None
    notes: Sequence[str] = ()

    def html(self) -> str:
        table = self.table.html() if self.table else ""
        body = "".join([self.pictures, table, piece("paragraphs", self.notes)])
        return str(piece("section", self.title, Markup(body)))

    def markdown(self) -> str:
        if self.table is None:
            return ""
        notes = map(tables.in_markdown, self.notes)
        return "\n\n".join([f"## {self.title}", self.table.markdown(), *notes])


def _tiles(results: Sequence[Result]) -> list[Tile]:
    """The first seed of each variant; of a search, the best trial."""
    variants = variants_of(results)
    if not variants:
        best = best_of(results)
        if best is None:
            return []
        # Of several candidates that share a job the film is the job's: who is seen in it is not known.
        return [Tile(str(best.said.get("job", best.trial.key)), best.path)]
    firsts = [next((r for r in v.results if r.ok), None) for v in variants]
    shown = enumerate(zip(variants, firsts, strict=True))
    return [Tile(v.name, r.path, i) for i, (v, r) in shown if r is not None]


def _headline(results: Sequence[Result], variants: Sequence[Variant]) -> str:
    done = sum(r.report is not None for r in results)
    failed = sum(r.report is not None and not r.ok for r in results)
    what, objective = "A search", objective_of(results)
    if variants:
        seeds = len({r.trial.seed for r in results})
        what = (
            f"{len(variants)} variant{'s' * (len(variants) > 1)}, {seeds} seed{'s' * (seeds > 1)}"
        )
    parts = [f"{what}: {done} of {len(results)} trials asked for are finished"]
    if failed:
        parts.append(f"{failed} of them failed")
    best = best_of(results)
    if not variants and best is not None and best.report is not None:
        at = ", ".join(f"{name}={value:g}" for name, value in best.trial.point.items())
        value = tables.shown(best.report.objective, objective)
        scaled = best.worth != best.report.objective
        value += f" (y {tables.shown(best.worth)})" if scaled else ""
        parts.append(
            f"the best {objective.replace('_', ' ')} is {value}, of {best.trial.key} ({at})"
        )
        if done > 1:
            parts.append(
                "it was chosen by the starts that it is judged on, so it is rather too good"
            )
    elif not variants and any(r.worth is not None for r in results):
        parts.append("none of them at full fidelity, so there is no answer")
    return "; ".join(parts) + "."


def _published(paper: Mapping[str, Any] | None, variants: Sequence[Variant]) -> list[str]:
    if not paper:
        return []
    notes = [f"Paper: {paper.get('caption', '')}"]
    names = {v.name for v in variants}
    others = [f"{k} {v:g}" for k, v in mapping(paper.get("values")).items() if k not in names]
    return notes + ([f"It also has: {', '.join(others)}."] if others else [])
