"""Learning curves of variants: the mean over seeds with a band, and thin curves of the seeds behind it."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

import numpy as np

from understudy_report.charts import Chart, Series, draw_series, thinned
from understudy_report.values import number
from understudy_sweeps.intervals import t_quantile
from understudy_sweeps.results import SUCCESS, Result, Variant

__all__ = ["legend", "mean_curve", "style_of"]

_EVALUATION = "evaluation/"
_TRAINING = (
    Chart("Return of training episodes", "episode/return"),
    Chart("Length of training episodes", "episode/episode_seconds", "s", low=0.0),
    Chart("Reward per step", "reward"),
)
#: Points of the samples' axis at which means are taken.
_POINTS = 100


def learning_curves(variants: Sequence[Variant]) -> dict[str, str]:
    """Charts as HTML, by heading."""
    results = [r for v in variants for r in v.results]
    keys = sorted({k for r in results for row in r.rows for k in row if k.startswith(_EVALUATION)})
    keys.sort(key=lambda key: key != _EVALUATION + SUCCESS)
    evaluations = [_evaluation(key.removeprefix(_EVALUATION)) for key in keys]
    end = max((p[-1, 0] for r in results if len(p := _points(r, "iteration"))), default=0.0)
    drawn = {
        "Evaluations": "".join(_draw(chart, variants, end) for chart in evaluations),
        "Training": "".join(_draw(chart, variants, end) for chart in _TRAINING),
    }
    return {heading: charts for heading, charts in drawn.items() if charts}


def _evaluation(name: str) -> Chart:
    if name == SUCCESS:
        return Chart("Success", _EVALUATION + name, "%", low=0.0, high=100.0, dots=True)
    return Chart(name.replace("_", " "), _EVALUATION + name, dots=True)


def _draw(chart: Chart, variants: Sequence[Variant], end: float) -> str:
    series = []
    for index, variant in enumerate(variants):
        found = [_points(r, chart.key) for r in variant.results]
        curves = [thinned(points) for points in found if len(points)]
        line, band = mean_curve(curves)
        series.append(Series(line, style_of(index), band, curves))
    return draw_series(chart, series, end)


def mean_curve(
    curves: Sequence[np.ndarray],
) -> tuple[np.ndarray, tuple[np.ndarray, np.ndarray] | None]:
    """The mean of `curves`, each (n, 2) of samples and values, where all of them are known, and the
    edges of its band: the 95 % interval of Student's t, least and greatest where there are two
    curves, None for one."""
    nothing = np.zeros((0, 2))
    if not curves:
        return nothing, None
    low, high = max(c[0, 0] for c in curves), min(c[-1, 0] for c in curves)
    if high < low:
        return nothing, None
    x = np.linspace(low, high, _POINTS if high > low else 1)
    values = np.array([np.interp(x, c[:, 0], c[:, 1]) for c in curves])
    mean = values.mean(axis=0)
    line, n = np.column_stack([x, mean]), len(curves)
    if n == 1:
        return line, None
    if n == 2:
        edges = values.min(axis=0), values.max(axis=0)
    else:
        reach = t_quantile(n) * values.std(axis=0, ddof=1) / np.sqrt(n)
        edges = mean - reach, mean + reach
    lower, upper = (np.column_stack([x, edge]) for edge in edges)
    return line, (lower, upper)


def _points(result: Result, key: str) -> np.ndarray:
    """(n, 2): samples and the value of `key`, where both are numbers."""
    pairs = [(number(row.get("samples")), number(row.get(key))) for row in result.rows]
    found = [(x, y) for x, y in pairs if x is not None and y is not None]
    return np.array(found).reshape(-1, 2)


def style_of(index: int) -> str:
    """CSS that distinguishes a variant's curves: a colour, and dashes from the seventh variant on."""
    dashes = ("none", "7 3", "2 3", "9 3 2 3")[min(index // 6, 3)]
    return f"--series: var(--variant-{index % 6}); --dashes: {dashes}"


def legend(names: Sequence[str]) -> str:
    """Which curves are whose, as HTML: `names` in the order of :func:`style_of`."""
    found = "".join(
        f'<span style="{style_of(i)}"><svg viewBox="0 0 28 8"><path class="series" d="M0 4H28"/></svg>'
        f"{escape(name)}</span>"
        for i, name in enumerate(names)
    )
    return f'<p class="variants">{found}</p>'
