"""Pictures of a search: its trials' values against their cost, and their parameters."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from understudy_report import words
from understudy_report.charts import HEIGHT, WIDTH, Axes, grid, svg
from understudy_sweeps.results import OBJECTIVE, Result, best_of, compared_in

#: Viridis, less its lightest end: its order is seen in grey and by colour-blind readers too.
_VIRIDIS = ((68, 1, 84), (59, 82, 139), (33, 145, 140), (94, 201, 98), (189, 206, 38))


def charts(results: Sequence[Result], objective: str) -> str:
    """Both pictures, and what they mean; nothing before a first trial is finished."""
    done = [r for r in results if r.worth is not None]
    if not done:
        return "<p>No trial is finished yet.</p>"
    scaled = any(r.worth != r.figure(OBJECTIVE) for r in done)
    name = "y" if scaled else objective.replace("_", " ")
    cards = [_card(f"{name} of each trial against all samples spent", _history(results))]
    if done[0].trial.point:
        cards.append(_card("Where the trials were", _parallel(done, name)))
    levels = sorted({r.trial.fidelity for r in done if r.trial.fidelity is not None})
    notes = ["The line is the best so far"]
    if levels:
        notes[0] += " of those that can be compared, and the dots' colours are fidelities"
    if any(r.trial.start for r in done):
        notes.append("dashes lead from a trial to those that began from it")
    key = "".join(
        f'<span><svg viewBox="0 0 28 8"><circle cx="14" cy="4" r="4" fill="{_level(level, levels)}"/></svg>'
        f"fidelity {level:g}</span>"
        for level in levels
    )
    return (
        (f'<p class="variants">{key}</p>' if key else "")
        + f'<div class="pair">{"".join(cards)}</div><p>{escape("; ".join(notes))}. In the second '
        f"picture a trial is a line through its values, light where {escape(name)} is high, the best one bold.</p>"
    )


def _card(title: str, picture: str) -> str:
    return f'<div class="card chart"><h4>{escape(title)}</h4>{picture}</div>'


def _history(results: Sequence[Result]) -> str:
    """A dot for each trial, at the samples that it and those asked for before it have spent."""
    compared, spent = {r.trial.key for r in compared_in(results)}, 0.0
    levels = sorted({r.trial.fidelity for r in results if r.trial.fidelity is not None})
    dots: dict[str, tuple[float, float, Result]] = {}
    for result in results:
        spent += result.report.cost if result.report else 0.0
        value = result.worth
        if value is not None:
            dots[result.trial.key] = (spent, value, result)
    values = [value for _, value, _ in dots.values()]
    low, high = min(values), max(values)
    pad = 0.07 * (high - low) or 0.5 * max(abs(low), 0.1)
    axes = Axes(low - pad, high + pad, 1.04 * spent)
    parts, best, line = [grid(axes)], -np.inf, []
    for x, value, result in dots.values():
        if result.trial.key in compared and value > best:
            line += [(x, best), (x, value)] if line else [(x, value)]
            best = value
    if line:
        path = axes.path([*line, (spent, best)])
        parts.append(f'<path class="best" d="{path}"/>')
    for x, value, result in dots.values():
        origin = dots.get(str((result.trial.start or {}).get("trial")))
        if origin is not None:
            parts.append(f'<path class="from" d="{axes.path([origin[:2], (x, value)])}"/>')
    for x, value, result in dots.values():
        level = result.trial.fidelity
        at = "" if level is None else f", fidelity {level:g}"
        parts.append(
            f'<circle class="trial" cx="{axes.across(x):.1f}" cy="{axes.down(value):.1f}" r="4.5" '
            f'fill="{_level(level, levels)}"><title>{escape(result.trial.key)}: '
            f"{words.short(value)}{at}</title></circle>"
        )
    return svg("".join(parts), "objective of each trial against samples spent")


def _parallel(done: Sequence[Result], objective: str) -> str:
    """A line for each trial across one axis for each parameter, the objective last."""
    names = list(dict.fromkeys(name for r in done for name in r.trial.point))
    rows = [{**r.trial.point, "fidelity": r.trial.fidelity, objective: r.worth} for r in done]
    if any(r.trial.fidelity is not None for r in done):
        names.append("fidelity")
    found = [[row.get(name) for name in (*names, objective)] for row in rows]
    values = np.array(found, dtype=float)
    best = best_of(done)
    least, most = np.nanmin(values, axis=0), np.nanmax(values, axis=0)
    shares = (values - least) / np.where(most > least, most - least, 1.0)
    top, bottom, left, right = 22.0, HEIGHT - 34.0, 40.0, WIDTH - 40.0
    xs = np.linspace(left, right, values.shape[1])
    ys = bottom - (bottom - top) * np.where(most > least, shares, 0.5)
    parts = []
    for x, name, low, high in zip(xs, [*names, objective], least, most, strict=True):
        parts.append(
            f'<path class="axis" d="M{x:.1f} {top:g}V{bottom:g}"/>'
            f'<text x="{x:.1f}" y="{top - 7:g}" text-anchor="middle">{words.short(high)}</text>'
            f'<text x="{x:.1f}" y="{bottom + 12:g}" text-anchor="middle">{words.short(low)}</text>'
            f'<text x="{x:.1f}" y="{bottom + 26:g}" text-anchor="middle">'
            f"{escape(_short(name, len(xs)))}<title>{escape(name)}</title></text>"
        )
    for index in np.argsort(values[:, -1]):  # the best are on top
        share = float(shares[index, -1])
        points = [f"{x:.1f} {y:.1f}" for x, y in zip(xs, ys[index], strict=True) if np.isfinite(y)]
        emphasis = " top" if done[index] is best else ""
        parts.append(
            f'<path class="parallel{emphasis}" stroke="{_viridis(share)}" d="M{"L".join(points)}">'
            f"<title>{escape(done[index].trial.key)}</title></path>"
        )
    return svg("".join(parts), "parameters and objective of each trial")


def _short(name: str, axes: int) -> str:
    """The end of a long name of an option, which is what tells it from others."""
    room = max(8, 66 // axes)
    last = name.rpartition(".")[2]
    return last if len(last) <= room else f"{last[: room - 1]}…"


def _level(fidelity: float | None, levels: Sequence[float]) -> str:
    if fidelity is None:
        return "var(--accent)"
    return _viridis(levels.index(fidelity) / max(len(levels) - 1, 1))


def _viridis(share: float) -> str:
    """The colour at `share` of the scale."""
    at = min(max(share, 0.0), 1.0) * (len(_VIRIDIS) - 1)
    low = min(int(at), len(_VIRIDIS) - 2)
    pair = zip(_VIRIDIS[low], _VIRIDIS[low + 1], strict=True)
    return "rgb(" + " ".join(f"{a + (b - a) * (at - low):.0f}" for a, b in pair) + ")"
