"""Tables of results: as HTML, Markdown and text for people, and as CSV with every digit."""

from __future__ import annotations

import csv
import io
import math
from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

from understudy import errors
from understudy_reinforcement.evaluation import wilson_interval
from understudy_report import words
from understudy_report.markup import grid
from understudy_report.values import interval, mapping, number
from understudy_sweeps.intervals import Mean, mean_of, paired_difference
from understudy_sweeps.results import (
    OBJECTIVE,
    SAMPLES,
    SECONDS,
    SUCCESS,
    UNSOUND,
    Result,
    Variant,
    compared_in,
    measures_of,
    objective_of,
    shares_of,
)

__all__ = ["Table", "as_csv", "in_markdown", "shown_mean"]

_NOTHING = "–"
#: Between which a figure can lie, so that its interval need not say more.
_BOUNDS = {
    SAMPLES: (0.0, math.inf),
    SECONDS: (0.0, math.inf),
}


@dataclass(frozen=True)
class Table:
    """Cells for people; the first of a row is its name."""

    heads: Sequence[str]
    rows: Sequence[Sequence[str]]

    def html(self) -> str:
        return f'<div class="wide">{grid(self.heads, self.rows)}</div>'

    def markdown(self) -> str:
        def line(cells: Sequence[str]) -> str:
            return "| " + " | ".join(in_markdown(cell) for cell in cells) + " |"

        return "\n".join([line(self.heads), line(["---"] * len(self.heads)), *map(line, self.rows)])

    def text(self) -> str:
        lines = [[errors.shown(cell) for cell in row] for row in (self.heads, *self.rows)]
        widths = [max(map(len, column)) for column in zip(*lines, strict=True)]
        return "\n".join(
            "  ".join(f"{cell:<{w}}" for cell, w in zip(row, widths, strict=True)).rstrip()
            for row in lines
        )


def in_markdown(cell: str) -> str:
    """`text` on one line, without any markup: names and errors may come from strangers."""
    for sign in "\\`*_[]<>|#":
        cell = cell.replace(sign, f"\\{sign}")
    return " ".join(cell.split())


# ---------------------------------------------------------------------- numbers in words


def shown(value: float | None, name: str = "") -> str:
    """A figure of the kind `name`, in three digits."""
    if value is None:
        return _NOTHING
    if name in (SUCCESS, UNSOUND):
        return words.share(value)
    return words.duration(value) if name == SECONDS else words.short(value)


def possible(mean: Mean, name: str, shares: Collection[str], *, sign: bool = False) -> Mean:
    """`mean` of the figure `name`, or with a `sign` of its differences, with an interval that can be."""
    if name in shares:
        return mean.clipped(-1.0 if sign else 0.0, 1.0)
    return mean.clipped(*_BOUNDS[name]) if name in _BOUNDS and not sign else mean


def shown_mean(
    mean: Mean | None,
    name: str = "",
    *,
    sign: bool = False,
    counted: bool = False,
    shares: Collection[str] = (SUCCESS, UNSOUND),
) -> str:
    """A mean and its interval; of two seeds that word, unless their number is `counted` beside it.
    `shares` are the figures that lie between 0 and 1."""
    if mean is None:
        return _NOTHING
    mean = possible(mean, name, shares, sign=sign)
    scale = 100.0 if name in (SUCCESS, UNSOUND) else 1.0

    def figure(value: float) -> str:
        if name == SECONDS:
            return words.duration(value)
        return ("+" if sign and value > 0 else "") + words.short(scale * value)

    unit = (" points" if sign else " %") if name in (SUCCESS, UNSOUND) else ""
    if mean.low is None or mean.high is None or (name == SAMPLES and mean.low == mean.high):
        few = " (2 seeds)" if mean.count == 2 and mean.low is None and not counted else ""
        return figure(mean.value) + unit + few
    return f"{figure(mean.value)}{unit} [{figure(mean.low)}, {figure(mean.high)}]"


# ---------------------------------------------------------------------- of variants


def compared(variants: Sequence[Variant], paper: Mapping[str, Any] | None) -> Table:
    """A row for each variant: means over seeds, the paper's number, and what it differs by from the
    first."""
    results = [r for v in variants for r in v.results]
    objective, first, shares = objective_of(results), variants[0], shares_of(results)
    figures = [SUCCESS] if SUCCESS in measures_of(results) else []
    figures += [] if objective in figures else [OBJECTIVE]
    judged, published = figures[-1] if objective != SUCCESS else SUCCESS, mapping(paper)
    values, of = mapping(published.get("values")), published.get("of", OBJECTIVE)
    if of not in (*figures, SAMPLES) and values:
        figures.append(str(of))
    figures += [UNSOUND] if UNSOUND in measures_of(results) else []
    criterion = any(r.state == "criterion" for r in results)
    heads = ["variant", "seeds"]
    for name in (*figures, SAMPLES):
        heads.append({SUCCESS: "success", OBJECTIVE: objective}.get(name, name))
        if values and _same(name, of, objective):
            heads.append("paper")
    heads += ["reached the criterion"] if criterion else []
    heads += ["training"]
    heads += [f"against {first.name}"] if len(variants) > 1 else []
    rows = []
    for variant in variants:
        done = [r for r in variant.results if r.ok]
        failed = sum(r.report is not None and not r.ok for r in variant.results)
        row = [variant.name, f"{len(done)}" + (f" ({failed} failed)" if failed else "")]
        for name in (*figures, SAMPLES):
            as_share = {name} if (objective if name == OBJECTIVE else name) in shares else ()
            mean = mean_of(list(variant.figures(name).values()))
            row.append(shown_mean(mean, name, shares=as_share))
            if values and _same(name, of, objective):
                row.append(shown(number(values.get(variant.name)), name))
        if criterion:
            row.append(f"{sum(r.state == 'criterion' for r in done)} of {len(done)}")
        row.append(shown_mean(mean_of(list(variant.figures(SECONDS).values())), SECONDS))
        if len(variants) > 1:
            difference = paired_difference(first.figures(judged), variant.figures(judged))
            as_share = {judged} if (objective if judged == OBJECTIVE else judged) in shares else ()
            shown_one = shown_mean(difference, judged, sign=True, shares=as_share)
            row.append(_NOTHING if variant is first else shown_one)
        rows.append(row)
    return Table(heads, rows)


def _same(name: str, of: Any, objective: str) -> bool:
    """Whether the figure `name` is what the published numbers are `of`."""
    return (
        name == of
        or (of == OBJECTIVE and name == objective)
        or (name == OBJECTIVE and of == objective)
    )


def compared_csv(variants: Sequence[Variant], paper: Mapping[str, Any] | None) -> bytes:
    """As :func:`compared` and all measures, every number in full."""
    published, first = mapping(paper), variants[0]
    results = [r for v in variants for r in v.results]
    shares = set(shares_of(results))
    shares |= {OBJECTIVE} if objective_of(results) in shares else set()
    names = [OBJECTIVE, SAMPLES, SECONDS, *measures_of(results)]
    rows = []
    for variant in variants:
        done = sum(r.ok for r in variant.results)
        failed = sum(r.report is not None and not r.ok for r in variant.results)
        row: dict[str, Any] = {"variant": variant.name, "seeds": done, "failed": failed}
        for name in names:
            mean = mean_of(list(variant.figures(name).values()))
            row |= _columns(name, mean and possible(mean, name, shares))
        difference = paired_difference(first.figures(OBJECTIVE), variant.figures(OBJECTIVE))
        row |= _columns("objective_difference", None if variant is first else difference)
        row["paper"] = mapping(published.get("values")).get(variant.name)
        rows.append(row)
    return _csv(rows)


def _columns(name: str, mean: Mean | None) -> dict[str, float | None]:
    return {
        name: mean.value if mean else None,
        f"{name}_low": mean.low if mean else None,
        f"{name}_high": mean.high if mean else None,
    }


def all_measures(variants: Sequence[Variant]) -> Table:
    """A row for each measure of the evaluations."""
    results = [r for v in variants for r in v.results]
    shares = shares_of(results)
    rows = [
        [
            name,
            *(
                shown_mean(mean_of(list(v.figures(name).values())), name, shares=shares)
                for v in variants
            ),
        ]
        for name in measures_of(results)
    ]
    return Table(["measure", *(v.name for v in variants)], rows)


# ---------------------------------------------------------------------- of trials


def trials(results: Sequence[Result]) -> Table:
    """A row for each trial; the best come first if it is a search."""
    searched = not any(r.trial.variant for r in results)
    points = list(dict.fromkeys(name for r in results for name in r.trial.point))
    levels = any(r.trial.fidelity is not None for r in results)
    starts = any(r.trial.start for r in results)
    success = SUCCESS in measures_of(results)
    objective = objective_of(results)
    heads = ["trial", "ended by", *([] if objective == SUCCESS else [objective])]
    scaled = any(r.worth != r.figure(OBJECTIVE) for r in results)
    marked = any(r.said.get("found") for r in results)
    heads += [*(["y"] if scaled else []), *(["found"] if marked else [])]
    heads += ["success"] if success else []
    unsound = UNSOUND in measures_of(results)
    heads += [UNSOUND] if unsound else []
    heads += ["fidelity"] if levels else []
    heads += [*points, *(["began from"] if starts else []), "samples", "training"]
    if searched:
        compared = {r.trial.key for r in compared_in(results)}
        results = sorted(
            results, key=lambda r: (r.worth is None, r.trial.key not in compared, -(r.worth or 0.0))
        )
    rows = []
    for r in results:
        row = [r.trial.key, r.state]
        row += [] if objective == SUCCESS else [shown(r.figure(OBJECTIVE))]
        row += [shown(r.worth)] if scaled else []
        row += [str(r.said.get("found") or "")] if marked else []
        row += [_episodes(r)] if success else []
        row += [shown(r.figure(UNSOUND), UNSOUND)] if unsound else []
        row += [shown(r.trial.fidelity)] if levels else []
        row += [shown(number(r.trial.point.get(name))) for name in points]
        row += [began_from(r.trial.start)] if starts else []
        rows.append([*row, shown(r.figure(SAMPLES)), shown(r.figure(SECONDS), SECONDS)])
    return Table(heads, rows)


def _episodes(result: Result) -> str:
    """The success rate of one trial, with the 95 % interval over its episodes."""
    rate = result.figure(SUCCESS)
    if rate is None:
        return _NOTHING
    evaluation = mapping(result.evaluation)
    if number(evaluation.get("success_rate")) != rate:  # made anew since, of something else
        evaluation = {}
    bounds = interval(evaluation.get("success_rate_95"))
    episodes = int(number(evaluation.get("episodes")) or 0)
    if bounds is None and episodes:
        bounds = wilson_interval(rate, episodes)
    if bounds is None:  # its run is gone: the journal has the rate alone
        return words.share(rate)
    return f"{words.share(rate)} [{100 * bounds[0]:.0f}, {100 * bounds[1]:.0f}]"


def began_from(start: Mapping[str, Any] | None) -> str:
    return str(mapping(start).get("trial") or mapping(start).get("run") or _NOTHING)


def trials_csv(results: Sequence[Result]) -> bytes:
    """A row for each trial, in the order in which they were asked for, every number in full."""
    points = list(dict.fromkeys(name for r in results for name in r.trial.point))
    rows = []
    for r in results:
        figures = {name: r.figure(name) for name in (OBJECTIVE, SAMPLES, SECONDS)}
        measures = {f"measure/{name}": r.figure(name) for name in measures_of(results)}
        rows.append(
            {
                "trial": r.trial.key,
                "variant": r.trial.variant,
                "seed": r.trial.seed,
                "status": r.report.status if r.report else "unfinished",
                "outcome": r.report.outcome if r.report else "",
                "fidelity": r.trial.fidelity,
                "began_from": began_from(r.trial.start) if r.trial.start else "",
                **{f"point/{name}": r.trial.point.get(name) for name in points},
                **figures,
                **{key: r.said[key] for key in ("y", "found") if key in r.said},
                **measures,
                "folder": r.path.name,
            }
        )
    return _csv(rows)


def _csv(rows: Sequence[Mapping[str, Any]]) -> bytes:
    heads = list(dict.fromkeys(name for row in rows for name in row))
    return as_csv([heads, *([row.get(name) for name in heads] for row in rows)] if rows else [])


def as_csv(rows: Iterable[Iterable[Any]]) -> bytes:
    """`rows` as a file for spreadsheets, which know by its first bytes that what is no ASCII is UTF-8. In its head, too,
    names may come from strangers."""
    file = io.StringIO()
    writer = csv.writer(file, lineterminator="\n")
    writer.writerows([_cell(value) for value in row] for row in rows)
    text = file.getvalue()
    return text.encode("ascii" if text.isascii() else "utf-8-sig", errors="replace")


def _cell(value: Any) -> Any:
    """Text that a spreadsheet would take for a formula is kept text."""
    if isinstance(value, str) and value[:1] in ("=", "+", "-", "@", "\t", "\r", "\n"):
        return f"'{value}"
    return value
