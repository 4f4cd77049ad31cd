"""The gallery of a diversity search: one page of every different strategy that needs nothing else.

``gallery.html`` stands in the search's folder; the drawn films and pictures in ``gallery/``.
"""

from __future__ import annotations

import base64
import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

from markupsafe import Markup

from understudy import __version__
from understudy.folders import read, write_atomically
from understudy.setup.config import Experiment
from understudy_diversity import maps
from understudy_diversity.novel_policies import NovelPolicies, known_strategies
from understudy_diversity.peaks import Take, figure, take_of
from understudy_diversity.strategies import (
    SUCCESS,
    DiversityOptions,
    GalleryOptions,
    Strategy,
    finished_trials,
    kinds,
)
from understudy_report import words
from understudy_report.markup import grid, piece
from understudy_report.page import html_page
from understudy_sweeps.journal import Journal
from understudy_sweeps.page import SweepPage
from understudy_sweeps.trial import folder_of

_STYLE = (Path(__file__).parent / "gallery.css").read_text(encoding="utf-8")
Options = DiversityOptions | NovelPolicies.Options


@dataclass(frozen=True)
class Exhibit:
    """A different strategy: the trial that does it best, and the others that show it too."""

    kind: int
    best: Strategy
    value: float | None  #: of ``best``, in the gallery's unit
    repeats: Sequence[Strategy]
    take: Take
    novel: bool = False  #: found from another strategy's policy (stage 2)


class Gallery(SweepPage):
    """Writes ``gallery.html``."""

    def write(
        self, folder: Path, title: str, experiment: Experiment, journal: Journal
    ) -> Path | None:
        chosen = experiment.one("outer_loop")
        if chosen is None or not isinstance(chosen.options, Options):
            return None
        options = chosen.options
        known: list[Strategy] = []
        if isinstance(options, NovelPolicies.Options):
            known = known_strategies(options.search, options)
        own = finished_trials(journal)
        strategies = kinds([*((s.trial, s.report) for s in known), *own], options)
        exhibits = _exhibits(strategies, len(known), folder, options.gallery)
        content = "".join(
            [
                piece("headline", _headline(exhibits, strategies, known, options)),
                _wall(exhibits, options, _ranges(strategies, options)),
                _peaks(exhibits, options.gallery),
                _section(
                    "Where strategies are",
                    maps.space(strategies, options, value_of)
                    + ("" if known else maps.parameters(strategies, options, experiment.root.seed)),
                ),
                _section("How they were found", maps.progress(strategies, len(known))),
                _section("All trials", f'<div class="wide">{_table(strategies, options)}</div>'),
            ]
        )
        path = folder / "gallery.html"
        over = f"understudy gallery · {__version__}"
        page = html_page(title, over, time.strftime("%Y-%m-%d %H:%M"), content, _STYLE)
        write_atomically(path, page)
        return path


def value_of(strategy: Strategy, options: GalleryOptions) -> float | None:
    """How well it does, in the gallery's unit."""
    report = strategy.report
    value = report.objective if options.best is None else report.measures.get(options.best)
    return None if value is None else value * options.scale


def name_of(option: str, options: GalleryOptions) -> str:
    """A parameter's or a feature's name for people: the chosen one, or the end of its path."""
    last = option.rpartition(".")[2]
    return options.names.get(option) or options.names.get(last) or last.replace("_", " ")


def _exhibits(
    strategies: Sequence[Strategy], known: int, folder: Path, options: GalleryOptions
) -> list[Exhibit]:
    """The best first."""
    by_kind: dict[int, list[tuple[int, Strategy]]] = {}
    for place, strategy in enumerate(strategies):
        if strategy.kind is not None:
            by_kind.setdefault(strategy.kind, []).append((place, strategy))
    found = []
    for kind, members in by_kind.items():
        worth = [(value_of(s, options) or 0.0, -place) for place, s in members]
        place, best = members[worth.index(max(worth))]
        run = Path(best.report.run) if place < known else folder_of(best.trial.key, folder)
        name = f"{'earlier-' if place < known else ''}{run.name}"
        take = take_of(run, folder / "gallery", name, options)
        repeats = [s for _, s in members if s is not best]
        novel = known > 0 and members[0][0] >= known
        found.append(Exhibit(kind, best, value_of(best, options), repeats, take, novel))
    return sorted(found, key=lambda e: -(e.value or 0.0))


def _headline(
    exhibits: Sequence[Exhibit],
    strategies: Sequence[Strategy],
    known: Sequence[Strategy],
    options: Options,
) -> str:
    trials = len(strategies) - len(known)
    many = f"{len(exhibits)} different {'strategy' if len(exhibits) == 1 else 'strategies'}"
    text = f"{many} in {trials} trials"
    if known:
        novel = sum(e.novel for e in exhibits)
        text = f"{many}, {novel} of them new in {trials} trials from those of the earlier search"
    kinds = [s.kind for s in strategies]
    own = range(len(known), len(strategies))
    failed = sum(kinds[k] is None for k in own)
    repeated = sum(kinds[k] is not None and kinds[k] in kinds[:k] for k in own)
    text += f"; {repeated} repeated one, {failed} failed."
    if exhibits and exhibits[0].value is not None:
        best = exhibits[0]
        text += f" The best, strategy {best.kind + 1}, {_value(best.value, options.gallery, long=True)}."
    return text


def _value(value: float | None, options: GalleryOptions, *, long: bool = False) -> str:
    if value is None:
        return "–"
    unit = f" {options.unit}" if options.unit else ""
    name = f"{options.best_name} " if long and options.best_name else ""
    return f"{name}{words.short(value)}{unit}"


def _section(title: str, content: str) -> str:
    return str(piece("section", title, Markup(content))) if content else ""


def _chip(kind: int) -> str:
    return f'<span class="chip" style="--kind:{maps.colour(kind)}">{kind + 1}</span>'


def _wall(
    exhibits: Sequence[Exhibit], options: Options, ranges: Mapping[str, tuple[float, float]]
) -> str:
    if not exhibits:
        return piece("failed", "No trial succeeded often enough to show a strategy.")
    return f'<div class="wall">{"".join(_card(e, options, ranges) for e in exhibits)}</div>'


def _card(exhibit: Exhibit, options: Options, ranges: Mapping[str, tuple[float, float]]) -> str:
    shown, best = options.gallery, exhibit.best
    badge = '<span class="badge">new</span>' if exhibit.novel else ""
    also = ", ".join(s.trial.key for s in exhibit.repeats)
    again = f"<p>Also found by {escape(also)}.</p>" if also else "<p>Found once.</p>"
    features = "".join(
        f"<div><dt>{escape(name_of(name, shown))}</dt><dd>{words.short(value)}</dd></div>"
        for name, value in zip(options.features, best.feature or (), strict=False)
    )
    bars = "".join(
        _slider(name_of(name, shown), value, *ranges[name])
        for name, value in best.trial.point.items()
    )
    caption = f"<small>{escape(shown.best_name)}</small>" if shown.best_name else ""
    return (
        f'<article class="card exhibit" style="--kind:{maps.colour(exhibit.kind)}">{_film(exhibit.take)}'
        f'<div class="plate"><div class="title">{_chip(exhibit.kind)}<h3>{escape(best.trial.key)}</h3>{badge}'
        f"<b>{escape(_value(exhibit.value, shown))}{caption}</b></div>"
        f"<dl>{features}</dl>{bars}{again}</div></article>"
    )


def _film(take: Take) -> str:
    if take.film is None:
        return (
            f'<div class="film none">{figure(take.outline, 0.0)}<p>{escape(take.reason)}</p></div>'
        )
    film = base64.b64encode(read(take.film)).decode()
    still = base64.b64encode(read(take.still)).decode() if take.still else ""
    return (
        '<div class="film"><video autoplay muted loop playsinline '
        f'poster="data:image/png;base64,{still}" src="data:video/mp4;base64,{film}"></video></div>'
    )


def _ranges(strategies: Sequence[Strategy], options: Options) -> dict[str, tuple[float, float]]:
    """By parameter: the range that was searched, else the one that was seen."""
    if isinstance(options, DiversityOptions):
        return {name: (p.low, p.high) for name, p in options.parameters.items()}
    seen: dict[str, list[float]] = {}
    for strategy in strategies:
        for name, value in strategy.trial.point.items():
            seen.setdefault(name, []).append(value)
    return {name: (min(values), max(values)) for name, values in seen.items()}


def _slider(name: str, value: float, low: float, high: float) -> str:
    """Where `value` is in its range."""
    share = 100 * (value - low) / (high - low) if high > low else 50.0
    return (
        f'<div class="slider"><span>{escape(name)}</span><i><u style="left:{share:.1f}%"></u></i>'
        f"<em>{words.short(value)}</em></div>"
    )


def _peaks(exhibits: Sequence[Exhibit], options: GalleryOptions) -> str:
    """Peak poses, the best first, seen from below and from above (figure 4.4)."""
    drawn = [e for e in exhibits if e.take.outline is not None or e.take.still is not None]
    if not drawn:
        return ""
    cells = []
    for exhibit in drawn:
        views = ""
        if exhibit.take.still is not None:
            still = base64.b64encode(read(exhibit.take.still)).decode()
            views += f'<img alt="at the peak" src="data:image/png;base64,{still}">'
        if exhibit.take.outline is not None:
            views += figure(exhibit.take.outline, -30.0) + figure(exhibit.take.outline, 35.0)
        cells.append(
            f'<div class="peak" style="--kind:{maps.colour(exhibit.kind)}">{views}'
            f"<p>{_chip(exhibit.kind)} {escape(_value(exhibit.value, options))}</p></div>"
        )
    note = "<p>The moment at the peak, and the pose there seen from below and from above; the best first.</p>"
    return _section("Peak poses", f'<div class="card peaks">{"".join(cells)}</div>{note}')


def _table(strategies: Sequence[Strategy], options: Options) -> str:
    names = list(dict.fromkeys(name for s in strategies for name in s.trial.point))
    heads = ["trial", "strategy", options.gallery.best_name or "objective", "success"]
    heads += [name_of(name, options.gallery) for name in (*options.features, *names)]
    rows = []
    for s in strategies:
        point: Mapping[str, float] = s.trial.point
        success = s.report.measures.get(SUCCESS)
        features = s.feature or [None] * len(options.features)
        row = [s.trial.key, "failed" if s.kind is None else str(s.kind + 1)]
        row += [_value(value_of(s, options.gallery), options.gallery)]
        row += ["–" if success is None else words.share(success)]
        row += ["–" if v is None else words.short(v) for v in (*features, *map(point.get, names))]
        rows.append(row)
    return grid(heads, rows)
