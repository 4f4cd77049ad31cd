"""Maps of a search: of what strategies are like, of where the surrogate expects them, and of how they
were found one after the other. SVG, for a page that needs nothing else."""

from __future__ import annotations

import base64
import colorsys
from collections.abc import Callable, Sequence
from html import escape
from itertools import combinations

import numpy as np
import torch

from understudy_bayes import draws
from understudy_diversity.novel_policies import NovelPolicies
from understudy_diversity.strategies import (
    DiversityOptions,
    GalleryOptions,
    Strategies,
    Strategy,
    distances,
)
from understudy_report import words
from understudy_report.pictures import png

#: Okabe and Ito's, which colour-blind readers tell apart, then others like them.
_COLOURS = ("#0072b2", "#d55e00", "#009e73", "#cc79a7", "#e69f00", "#56b4e9", "#8c6bb1", "#a6761d",
            "#1b9e9e", "#b2182b")  # fmt: skip
#: Cells of a map along each side, and points over which what is not shown is averaged.
_CELLS, _OTHERS = 40, 16

Value = Callable[[Strategy, GalleryOptions], float | None]
Options = DiversityOptions | NovelPolicies.Options


def colour(kind: int) -> str:
    """Of the strategy of this number."""
    if kind < len(_COLOURS):
        return _COLOURS[kind]
    shade = colorsys.hls_to_rgb((0.618 * kind) % 1.0, 0.45, 0.6)
    return "#" + "".join(f"{round(255 * c):02x}" for c in shade)


def _dot(x: float, y: float, strategy: Strategy, radius: float = 9.0) -> str:
    title = f"<title>{escape(strategy.trial.key)}</title>"
    if strategy.kind is None:
        return f'<path class="miss" d="M{x - 4:.1f} {y - 4:.1f}l8 8m0 -8l-8 8">{title}</path>'
    return (
        f'<g class="dot-of"><circle cx="{x:.1f}" cy="{y:.1f}" r="{radius:g}" '
        f'fill="{colour(strategy.kind)}"/><text x="{x:.1f}" y="{y + 3.4:.1f}" text-anchor="middle">'
        f"{strategy.kind + 1}</text>{title}</g>"
    )


def _name(option: str, options: Options) -> str:
    names, last = options.gallery.names, option.rpartition(".")[2]
    return names.get(option) or names.get(last) or last.replace("_", " ")


def _frame(width: float, height: float, content: str, label: str) -> str:
    return (
        f'<svg viewBox="0 0 {width:g} {height:g}" role="img" aria-label="{escape(label)}" '
        f'xmlns="http://www.w3.org/2000/svg">{content}</svg>'
    )


# ------------------------------------------------------------------ what they are like


def space(strategies: Sequence[Strategy], options: Options, value: Value) -> str:
    """Features against results: one feature as an axis, two as both axes, and more as the plane that keeps their
    distances best (classical scaling)."""
    shown = [s for s in strategies if s.feature is not None]
    if not shown:
        return ""
    features, names = list(options.features.values()), list(options.features)
    f = torch.tensor([s.feature for s in shown], dtype=torch.float64)
    across = (features[0].low, features[0].high)
    if len(features) == 1:
        y = np.array([value(s, options.gallery) or 0.0 for s in shown])
        pad = 0.15 * float(np.ptp(y)) or 1.0
        up, points = (float(y.min()) - pad, float(y.max()) + pad), np.column_stack([f[:, 0], y])
        unit = f", {options.gallery.unit}" if options.gallery.unit else ""
        labels = [_name(names[0], options), (options.gallery.best_name or "objective") + unit]
    elif len(features) == 2:
        up, points = (features[1].low, features[1].high), f.numpy()
        labels = [_name(names[0], options), _name(names[1], options)]
    else:
        points = _scaled(distances(f, f, options.metric).numpy())
        reach = 1.15 * float(np.abs(points).max()) or 1.0
        across = up = (-reach, reach)
        labels = ["distance of features, in the plane that keeps it best", ""]
    width, height, left, bottom = 900.0, 300.0, 56.0, 44.0
    x = left + (points[:, 0] - across[0]) / (across[1] - across[0]) * (width - left - 20)
    y = 16 + (up[1] - points[:, 1]) / (up[1] - up[0]) * (height - bottom - 28)
    ticks = "".join(
        f'<path class="grid" d="M{at:.1f} 10V{height - bottom:g}"/><text x="{at:.1f}" '
        f'y="{height - bottom + 16:g}" text-anchor="middle">{words.short(v)}</text>'
        for v in np.linspace(*across, 9)
        for at in [left + (v - across[0]) / (across[1] - across[0]) * (width - left - 20)]
    ) + "".join(
        f'<path class="grid" d="M{left:g} {at:.1f}H{width - 20:g}"/><text x="{left - 8:g}" '
        f'y="{at + 4:.1f}" text-anchor="end">{words.short(v)}</text>'
        for v in np.linspace(*up, 5)
        for at in [16 + (up[1] - v) / (up[1] - up[0]) * (height - bottom - 28)]
    )
    ticks += (
        f'<text class="name" x="{(left + width) / 2:g}" y="{height - 8:g}" text-anchor="middle">'
        f'{escape(labels[0])}</text><text class="name" x="{left - 40:g}" y="{height / 2 - 14:g}" '
        f'transform="rotate(-90 {left - 40:g} {height / 2 - 14:g})" text-anchor="middle">'
        f"{escape(labels[1])}</text>"
    )
    dots = "".join(_dot(float(a), float(b), s) for a, b, s in zip(x, y, shown, strict=True))
    note = (
        f"<p>Each dot is a trial, numbered and coloured by its strategy; trials nearer than "
        f"{words.short(options.distinct)} to one another are of the same one.</p>"
    )
    picture = _frame(width, height, ticks + dots, "the strategies that were found")
    return f'<div class="card chart scroll">{picture}</div>{note}'


def _scaled(apart: np.ndarray) -> np.ndarray:
    """(n, 2) points whose distances are as near to `apart` (n, n) as a plane allows (Torgerson 1952)."""
    n = len(apart)
    centring = np.eye(n) - 1.0 / n
    values, vectors = np.linalg.eigh(-0.5 * centring @ apart**2 @ centring)
    best = np.argsort(values)[::-1][:2]
    points = np.zeros((n, 2))
    points[:, : len(best)] = vectors[:, best] * np.sqrt(np.clip(values[best], 0.0, None))
    return points


# ------------------------------------------------------------------ where they are expected


def parameters(strategies: Sequence[Strategy], options: Options, seed: int) -> str:
    """For each pair of parameters, the strategy nearest to what the surrogate expects there, fainter where
    it knows less; what is not shown is averaged over."""
    assert isinstance(options, DiversityOptions)
    book = Strategies(options)
    for s in strategies:
        book.book.trials[s.trial.key] = s.trial
        book.book.reports[s.trial.key] = s.report
    # a sweep of other loops is drawn without BoTorch
    from understudy_diversity.search import model_of

    made = model_of(book, seed, len(strategies))
    names = list(options.parameters)
    if made is None:
        return ""
    model, _ = made
    firsts = {s.kind: s for s in reversed(strategies) if s.kind is not None}
    numbers = sorted(firsts)
    found = torch.tensor([firsts[kind].feature for kind in numbers], dtype=torch.float64)
    colours = np.array([[int(colour(k)[i : i + 2], 16) for i in (1, 3, 5)] for k in numbers])
    places = np.array([book.space.unit(s.trial.point) for s in strategies])
    pairs = list(combinations(range(len(names)), 2)) or [(0, 0)]
    along = (torch.arange(_CELLS, dtype=torch.float64) + 0.5) / _CELLS
    rest = draws.many(seed, 0, len(names), _OTHERS)
    cards = []
    for a, b in pairs:
        x = rest.repeat(_CELLS * _CELLS, 1)
        v, u = torch.meshgrid(along.flip(0), along, indexing="ij")
        x[:, b] = v.reshape(-1).repeat_interleave(_OTHERS)
        x[:, a] = u.reshape(-1).repeat_interleave(_OTHERS)
        mean, deviation = model.posterior(x)
        mean = mean.view(_CELLS * _CELLS, _OTHERS, -1).mean(1)
        unsure = deviation.norm(dim=-1).view(-1, _OTHERS).mean(1).numpy()
        nearest = distances(mean, found, options.metric).argmin(-1).numpy()
        prior = np.linalg.norm([0.5 * (f.high - f.low) for f in options.features.values()])
        sure = np.clip(1.0 - unsure / prior, 0.12, 1.0)
        image = np.concatenate([colours[nearest], (200 * sure)[:, None]], axis=1)
        image = image.reshape(_CELLS, _CELLS, 4).round().astype(np.uint8)
        cards.append(_panel(image, places[:, [a, b]], strategies, names[a], names[b], options))
    note = (
        "<p>What the surrogate expects of the strategy at each take-off, in the strategies' colours, the "
        "fainter the less it knows; trials as dots, failed ones as crosses.</p>"
    )
    return f'<div class="panels">{"".join(cards)}</div>{note}'


def _panel(
    image: np.ndarray,
    places: np.ndarray,
    strategies: Sequence[Strategy],
    across: str,
    up: str,
    options: DiversityOptions,
) -> str:
    size, left, bottom = 300.0, 44.0, 40.0
    data = base64.b64encode(png(image)).decode()
    picture = (
        f'<image x="{left:g}" y="8" width="{size:g}" height="{size:g}" preserveAspectRatio="none" '
        f'href="data:image/png;base64,{data}"/>'
        f'<rect class="axis" x="{left:g}" y="8" width="{size:g}" height="{size:g}"/>'
    )
    dots = "".join(
        _dot(left + size * x, 8 + size * (1 - y), s)
        for (x, y), s in zip(places, strategies, strict=True)
    )
    a, b = options.parameters[across], options.parameters[up]
    foot = 8 + size
    labels = (
        f'<text x="{left:g}" y="{foot + 15:g}">{words.short(a.low)}</text>'
        f'<text x="{left + size:g}" y="{foot + 15:g}" text-anchor="end">{words.short(a.high)}</text>'
        f'<text class="name" x="{left + size / 2:g}" y="{foot + 30:g}" text-anchor="middle">'
        f"{escape(_name(across, options))}</text>"
        f'<text x="{left - 6:g}" y="{foot:g}" text-anchor="end">{words.short(b.low)}</text>'
        f'<text x="{left - 6:g}" y="18" text-anchor="end">{words.short(b.high)}</text>'
        f'<text class="name" x="14" y="{8 + size / 2:g}" text-anchor="middle" '
        f'transform="rotate(-90 14 {8 + size / 2:g})">{escape(_name(up, options))}</text>'
    )
    svg = _frame(left + size + 12, foot + bottom, picture + labels + dots, f"{across} and {up}")
    return f'<div class="card chart">{svg}</div>'


# ------------------------------------------------------------------ how they were found


def progress(strategies: Sequence[Strategy], known: int) -> str:
    """How many different strategies there were after each trial."""
    if len(strategies) == known:
        return ""
    seen: set[int] = {s.kind for s in strategies[:known] if s.kind is not None}
    counts = [len(seen)]
    for s in strategies[known:]:
        seen |= {s.kind} if s.kind is not None else set()
        counts.append(len(seen))
    width, height, left, bottom = 900.0, 230.0, 44.0, 40.0
    most, n = max(counts) + 0.6, len(counts) - 1
    step = (width - left - 20) / n

    def down(value: float) -> float:
        return 12 + (height - bottom - 12) * (1 - value / most)

    grid = "".join(
        f'<path class="grid" d="M{left:g} {down(v):.1f}H{width - 20:g}"/><text x="{left - 8:g}" '
        f'y="{down(v) + 4:.1f}" text-anchor="end">{v}</text>'
        for v in range(0, max(counts) + 1, max(1, max(counts) // 6))
    )
    line = f"M{left:g} {down(counts[0]):.1f}" + "".join(
        f"H{left + step * (i + 0.5):.1f}V{down(c):.1f}" for i, c in enumerate(counts[1:])
    )
    dots = "".join(
        _dot(left + step * (i + 0.5), down(counts[i + 1]), s)
        for i, s in enumerate(strategies[known:])
    )
    every = max(1, n // 12)
    ticks = "".join(
        f'<text x="{left + step * (i + 0.5):.1f}" y="{height - bottom + 18:g}" text-anchor="middle">'
        f"{i + 1}</text>"
        for i in range(0, n, every)
    )
    name = (
        f'<text class="name" x="{(left + width) / 2:g}" y="{height - 6:g}" text-anchor="middle">'
        "trials</text>"
    )
    body = f'{grid}<path class="stairs" d="{line}H{width - 20:g}"/>{ticks}{name}{dots}'
    picture = _frame(width, height, body, "different strategies found against trials")
    return (
        f'<div class="card chart scroll">{picture}</div><p>Different strategies found so far.</p>'
    )
