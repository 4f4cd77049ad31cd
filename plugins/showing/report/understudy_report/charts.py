"""Curves of metrics against samples, as cards with an SVG in them; one curve, or several to compare."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from understudy_report import words
from understudy_report.values import Row, number

__all__ = [
    "HEIGHT",
    "WIDTH",
    "Axes",
    "Chart",
    "Series",
    "draw_chart",
    "draw_series",
    "grid",
    "svg",
    "thinned",
]


@dataclass(frozen=True)
class Chart:
    """What to draw of the metrics, against samples."""

    title: str
    key: str
    unit: str = ""  #: with "%", values are shares
    low: float | None = None  #: the axis begins here; None: where the values do
    high: float | None = None
    cut: tuple[float, float] = (-math.inf, math.inf)  #: the axis never extends beyond
    dots: bool = False  #: whether each value is marked, where there are few
    #: A key whose rows have values that are only the most that it could be: rings, below which the value lies.
    at_most: str = ""


@dataclass(frozen=True)
class Mark:
    """Something that happened during the training: a vertical line with a label."""

    samples: float
    label: str


#: Size of a chart and of the margins around its plot, in the SVG's own pixels.
WIDTH, HEIGHT = 340.0, 176.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 14.0, 8.0, 34.0
#: Long curves are drawn as means over this many stretches, in a band from least to greatest.
_STRETCHES = 120
#: The room that a mark's label needs: across in pixels, along in characters.
_LABEL_ROOM, _LABEL_LENGTH = 11.0, 26


def draw_chart(
    chart: Chart, rows: Sequence[Row], marks: Sequence[Mark] = (), end: float | None = None
) -> str:
    """One curve as a card; nothing if no row has the value.

    Parameters
    ----------
    chart
        Which metric, and how.
    rows
        The metrics; values that are no finite numbers are counted and left out.
    marks
        What to mark on the samples' axis.
    end
        Where the samples' axis ends; by default at the curve's last point.
    """
    values = [(row.get("samples"), row[chart.key]) for row in rows if chart.key in row]
    numbers = [(number(x), number(y)) for x, y in values]
    scale = 100.0 if chart.unit == "%" else 1.0
    rings = {
        (x, scale * y)
        for row in rows
        if row.get(chart.at_most) is True
        and (x := number(row.get("samples"))) is not None
        and (y := number(row.get(chart.key))) is not None
    }
    points = np.array([(x, y) for x, y in numbers if x is not None and y is not None])
    if not values:
        return ""
    title, missing = escape(chart.title), len(values) - len(points)
    note = f"<small>{missing:,} not finite</small>" if missing else ""
    if not len(points):
        return f'<div class="card chart"><h4>{title}</h4>{note}</div>'
    points = points * [1, scale]
    unit = f" {chart.unit}" if chart.unit else ""
    last = f"{'≤ ' if tuple(points[-1]) in rings else ''}{words.short(points[-1, 1])}{unit}"
    end = max(float(points[:, 0].max()), 1.0, end or 0.0)
    plot = _plot(chart, points, marks, end, rings)
    note += "<small>○ at most</small>" if rings else ""
    return (
        f'<div class="card chart"><h4>{title}{note}<b>{escape(last)}</b></h4>'
        f"{svg(plot, f'{chart.title} against samples')}</div>"
    )


class Axes:
    """Where samples and values are in the SVG."""

    def __init__(self, low: float, high: float, end: float) -> None:
        self.low, self.high, self.end = low, high, max(end, 1e-9)
        self.right, self.bottom = WIDTH - _RIGHT, HEIGHT - _BOTTOM

    def across(self, samples: float) -> float:
        return _LEFT + (self.right - _LEFT) * max(samples, 0.0) / self.end

    def down(self, value: float) -> float:
        height = (min(max(value, self.low), self.high) - self.low) / (self.high - self.low)
        return self.bottom - (self.bottom - _TOP) * height

    def path(self, points: Sequence[tuple[float, float]]) -> str:
        return "M" + "L".join(f"{self.across(x):.1f} {self.down(y):.1f}" for x, y in points)


@dataclass(frozen=True)
class Series:
    """One of several curves in a chart; points are (n, 2) of samples and values."""

    line: np.ndarray
    style: str  #: CSS of its strokes, ``--series`` its colour
    band: tuple[np.ndarray, np.ndarray] | None = None  #: the lower and the upper edge
    thin: Sequence[np.ndarray] = ()  #: what it is the mean of


def draw_series(chart: Chart, series: Sequence[Series], end: float) -> str:
    """Several curves as a card; nothing if there is no point."""
    scale = 100.0 if chart.unit == "%" else 1.0
    groups = [[s.line, *s.thin, *(s.band or ())] for s in series]
    values = [p[:, 1] * scale for group in groups for p in group if len(p)]
    if not values:
        return ""
    axes = Axes(*_range(np.concatenate(values), chart), end)
    title = escape(chart.title) + (f" <small>{escape(chart.unit)}</small>" if chart.unit else "")
    parts = []

    def path(points: np.ndarray) -> str:
        return axes.path([(x, y * scale) for x, y in points.tolist()])

    for one in series:
        inner = []
        if one.band is not None:
            edge = np.concatenate([one.band[1], one.band[0][::-1]])
            inner.append(f'<path class="series-band" d="{path(edge)}Z"/>')
        inner += [f'<path class="series-thin" d="{path(p)}"/>' for p in one.thin if len(p) > 1]
        if len(one.line) > 1:
            inner.append(f'<path class="series" d="{path(one.line)}"/>')
        if chart.dots:
            for points in one.thin:
                inner += [
                    f'<circle class="series-dot" cx="{axes.across(x):.1f}" '
                    f'cy="{axes.down(y * scale):.1f}" r="2"/>'
                    for x, y in points.tolist()
                ]
        parts.append(f'<g style="{escape(one.style)}">{"".join(inner)}</g>')
    return f'<div class="card chart"><h4>{title}</h4>{svg(grid(axes) + "".join(parts), chart.title)}</div>'


def svg(content: str, label: str, height: float = HEIGHT) -> str:
    """An SVG of the charts' width."""
    return (
        f'<svg viewBox="0 0 {WIDTH:g} {height:g}" role="img" aria-label="{escape(label)}" '
        f'xmlns="http://www.w3.org/2000/svg">{content}</svg>'
    )


def thinned(points: np.ndarray, most: int = _STRETCHES) -> np.ndarray:
    """`points` (n, 2) as means over at most `most` stretches."""
    if len(points) <= most:
        return points
    return np.array([stretch.mean(axis=0) for stretch in np.array_split(points, most)])


def _plot(
    chart: Chart,
    points: np.ndarray,
    marks: Sequence[Mark],
    end: float,
    rings: set[tuple[float, float]],
) -> str:
    """Axes, marks and the curve through `points` (n, 2) of samples and values, some as rings."""
    axes = Axes(*_range(points[:, 1], chart), end)
    return grid(axes) + _marks(marks, axes) + _curve(points, axes, chart.dots, rings)


def _range(values: np.ndarray, chart: Chart) -> tuple[float, float]:
    """Where the value axis begins and ends."""
    low = float(values.min()) if chart.low is None else chart.low
    high = float(values.max()) if chart.high is None else chart.high
    low, high = max(low, chart.cut[0]), min(high, chart.cut[1])
    if high - low <= 1e-6 * max(abs(low), abs(high), 1e-6):
        pad = 0.5 * max(abs(low), 0.1)
        return (low if chart.low is not None else low - pad), low + pad
    pad = 0.05 * (high - low)
    return (low if chart.low is not None else low - pad), (
        high if chart.high is not None else high + pad
    )


def grid(axes: Axes, below: str = "samples") -> str:
    """SVG of the lines behind a chart, with their numbers; `below` is said under the axis."""
    parts = []
    ticks, step = _ticks(axes.low, axes.high, 4)
    for tick in ticks:
        y = axes.down(tick)
        parts.append(
            f'<path class="grid" d="M{_LEFT:g} {y:.1f}H{axes.right:g}"/>'
            f'<text x="{_LEFT - 6:g}" y="{y + 3.5:.1f}" text-anchor="end">{_label(tick, step)}</text>'
        )
    ticks, step = _ticks(0.0, axes.end, 5)
    for tick in ticks:
        x = axes.across(tick)
        parts.append(
            f'<path class="grid" d="M{x:.1f} {_TOP:g}V{axes.bottom:g}"/>'
            f'<text x="{x:.1f}" y="{axes.bottom + 14:g}" text-anchor="middle">{_label(tick, step)}</text>'
        )
    parts.append(
        f'<path class="axis" d="M{_LEFT:g} {_TOP:g}V{axes.bottom:g}H{axes.right:g}"/>'
        f'<text x="{(_LEFT + axes.right) / 2:g}" y="{HEIGHT - 5:g}" text-anchor="middle">{escape(below)}</text>'
    )
    return "".join(parts)


def _marks(marks: Sequence[Mark], axes: Axes) -> str:
    """A vertical line each, and labels along those that have room; pointing at one tells it."""
    parts = []
    free = -math.inf  # where the next label has room
    for mark in sorted((m for m in marks if m.samples <= axes.end), key=lambda m: m.samples):
        x, label = axes.across(mark.samples), mark.label
        parts.append(
            f'<path class="mark" d="M{x:.1f} {_TOP:g}V{axes.bottom:g}">'
            f"<title>{escape(label)} ({mark.samples:,.0f} samples)</title></path>"
        )
        if x >= free:
            short = label if len(label) <= _LABEL_LENGTH else f"{label[: _LABEL_LENGTH - 1]}…"
            parts.append(
                f'<text class="mark-label" transform="translate({x - 3:.1f} {_TOP + 2:g}) rotate(-90)" '
                f'text-anchor="end">{escape(short)}</text>'
            )
            free = x + _LABEL_ROOM
    return "".join(parts)


def _curve(points: np.ndarray, axes: Axes, dots: bool, rings: set[tuple[float, float]]) -> str:
    short = len(points) <= 2 * _STRETCHES
    stretches = np.array_split(points, len(points) if short else _STRETCHES)
    means = [(s[:, 0].mean(), s[:, 1].mean()) for s in stretches]
    parts = []
    if not short:
        upper = [(x, s[:, 1].max()) for (x, _), s in zip(means, stretches, strict=True)]
        lower = [(x, s[:, 1].min()) for (x, _), s in zip(means, stretches, strict=True)]
        parts.append(f'<path class="band" d="{axes.path(upper + lower[::-1])}Z"/>')
    line = [point for point in means if point not in rings]
    if len(line) > 1:
        parts.append(f'<path class="line" d="{axes.path(line)}"/>')
    if len(means) == 1 or (dots and short):
        radius = 3.5 if len(means) == 1 else 2.5
        parts += [
            f'<circle class="{"ring" if (x, y) in rings else "dot"}" '
            f'cx="{axes.across(x):.1f}" cy="{axes.down(y):.1f}" r="{radius}"/>'
            for x, y in means
        ]
    return "".join(parts)


def _ticks(low: float, high: float, count: int) -> tuple[list[float], float]:
    """Round values from `low` to `high`, at most about `count` of them, and the step between."""
    rough = (high - low) / count
    power = 10.0 ** math.floor(math.log10(rough))
    step = next(m * power for m in (1, 2, 5, 10) if m * power >= rough * (1 - 1e-9))
    first, last = math.ceil(low / step - 1e-9), math.floor(high / step + 1e-9)
    return [i * step for i in range(first, last + 1)], step


def _label(tick: float, step: float) -> str:
    """`tick` as text in which ticks `step` apart (1, 2 or 5 times a power of ten) differ."""
    largest = max(abs(tick), step)
    if largest >= 1e12 or step < 1e-4:
        return f"{tick:.3g}"
    suffix, size = next(
        (s, v)
        for s, v in (("G", 1e9), ("M", 1e6), ("k", 1e3), ("", 1.0))
        if largest >= v or v == 1.0
    )
    decimals = max(0, -math.floor(math.log10(step / size) + 1e-9))
    return f"{tick / size:.{decimals}f}{suffix}" if tick else "0"
