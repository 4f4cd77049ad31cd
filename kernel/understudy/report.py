"""The report of a run: one HTML file that needs nothing else, not even the network.

Names, configurations and metrics may come from strangers, so all text is escaped where it enters
the page, and the page's security policy lets no script run but the stick figure player.
"""

from __future__ import annotations

import base64
import hashlib
import json
import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path
from string import Template
from typing import Any

import numpy as np
import yaml

from understudy.pictures import ANIMATION_SCRIPT, stick_figure_animation, stick_figure_svg
from understudy.records.checkpoint import write_atomically
from understudy.records.runs import Run

Row = Mapping[str, Any]


def write_report(
    run: Run,
    outlines: np.ndarray | None = None,
    reference: np.ndarray | None = None,
    dt: float = 1 / 30,
) -> Path:
    """Write ``report.html`` into the folder of `run` from what is there; returns its path.

    Parameters
    ----------
    run
        The run; its evaluation, metrics and video may be missing.
    outlines
        (T, S, 2, 3) m, stick figures of the learned motion (world frame, z up).
    reference
        (T, S, 2, 3) m, stick figures of the motion it should follow.
    dt
        Seconds between stick figures.

    Raises
    ------
    RunError
        if the file cannot be written; the old one is untouched.
    """
    rows = [row for row in run.metrics() if isinstance(row, Mapping)]
    evaluation = _read_evaluation(run.path / "evaluation.json")
    task = _text(_mapping(run.info.get("config")).get("task") or run.path.name)
    page = _PAGE.substitute(
        policy=_security_policy(),
        style=_STYLE,
        task=escape(task),
        created=escape(_text(run.info.get("created", ""))[:16].replace("T", " ")),
        headline=escape(_headline(run.info, evaluation, rows)),
        tiles=_tiles(evaluation, rows),
        sections="".join(
            [
                _section("Motion", _motion(run.path / "video.mp4", outlines, reference, dt)),
                _section("Learning", _learning(rows)),
                _section("Evaluation", _evaluation(evaluation)),
                _section("Provenance", _provenance(run.info)),
                _section("Configuration", _configuration(run.info)),
            ]
        ),
    )
    path = run.path / "report.html"
    # JSON can smuggle in lone surrogates, which UTF-8 has no bytes for.
    write_atomically(path, page.encode(errors="replace"))
    return path


# ---------------------------------------------------------------------- values from files


def _read_evaluation(path: Path) -> Row:
    """The last evaluation; empty if there is none or it cannot be read."""
    try:
        return _mapping(json.loads(path.read_bytes()))
    except (OSError, ValueError, RecursionError):
        return {}


def _mapping(value: Any) -> Mapping[str, Any]:
    return value if isinstance(value, Mapping) else {}


def _sequence(value: Any) -> Sequence[Any]:
    return value if isinstance(value, list | tuple) else []


def _number(value: Any) -> float | None:
    """`value` as a number that can be drawn, if it is one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < 1e30 else None  # false for NaN too


def _text(value: Any) -> str:
    """`value` on one line: lists as words, everything else as JSON would say it."""
    if isinstance(value, str):
        return value
    if isinstance(value, list | tuple):
        return ", ".join(map(_text, value))
    if isinstance(value, float):
        return f"{value:g}"
    return json.dumps(value, ensure_ascii=False, default=str)


def _share(value: float) -> str:
    """A share in percent. Only exact zeros and ones are 0 % and 100 %."""
    percent = 100 * value
    if round(percent) in (0, 100) and value not in (0.0, 1.0):
        percent = min(max(round(percent, 1), 0.1), 99.9)
        return f"{percent:.1f} %"
    return f"{percent:.0f} %"


def _duration(seconds: float) -> str:
    """Seconds in the unit that suits them."""
    for unit, size in (("h", 3600.0), ("min", 60.0)):
        if seconds >= 2 * size:
            return f"{seconds / size:.1f} {unit}"
    return f"{seconds:.1f} s"


def _short(value: float) -> str:
    """`value` in three digits, such as ``614k``."""
    for suffix, size in (("G", 999.5e6), ("M", 999.5e3), ("k", 999.5)):
        if abs(value) >= size:
            return f"{value / (size / 0.9995):.3g}{suffix}"
    return f"{value:.3g}"


# ---------------------------------------------------------------------- the result


def _headline(info: Row, evaluation: Row, rows: Sequence[Row]) -> str:
    """The result of the run in one sentence."""
    samples, seconds = _effort(evaluation, rows)
    rate, episodes = _number(evaluation.get("success_rate")), _number(evaluation.get("episodes"))
    effort = []
    if samples is not None:
        effort.append(f"{samples:,.0f} samples")
    if seconds is not None:
        effort.append(f"{_duration(seconds)} of training{_hardware(info)}")
    after = " and ".join(effort)
    if rate is None or episodes is None:
        return f"Not evaluated yet, after {after}." if after else "Nothing has been learned yet."
    length = _number(evaluation.get("episode_seconds"))
    of_length = "" if length is None else f" of {length:g} s"
    interval = _interval(evaluation)
    within = f" (95 % interval {interval})" if interval else ""
    return (
        f"{_share(rate)} of {episodes:,.0f} episodes{of_length} succeeded{within}"
        + (f", after {after}" if after else "")
        + "."
    )


def _effort(evaluation: Row, rows: Sequence[Row]) -> tuple[float | None, float | None]:
    """Samples and training seconds behind the evaluated policy, or spent so far."""
    samples = _number(evaluation.get("samples"))
    seconds = None
    for row in rows:
        seen = _number(row.get("samples"))
        if seen is None or (evaluation and samples is not None and seen > samples):
            continue
        seconds = _number(row.get("seconds"))
        if not evaluation:
            samples = seen
    return samples, seconds


def _hardware(info: Row) -> str:
    device = _mapping(info.get("config")).get("device", "cpu")
    cores = _number(_mapping(info.get("machine")).get("cores"))
    if device != "cpu":
        return f" on {_text(device)}"
    return f" on {cores:.0f} core{'s' if cores > 1 else ''}" if cores else ""


def _interval(evaluation: Row) -> str:
    bounds = [_number(bound) for bound in _sequence(evaluation.get("success_rate_95"))]
    match bounds:
        case [float(low), float(high)]:
            return f"{100 * low:.0f}–{100 * high:.0f} %"
    return ""


def _tiles(evaluation: Row, rows: Sequence[Row]) -> str:
    """The figures to remember, as a row of tiles."""
    samples, seconds = _effort(evaluation, rows)
    rate = _number(evaluation.get("success_rate"))
    lasted = _number(evaluation.get("mean_episode_seconds"))
    unbroken = _number(evaluation.get("within_all_bounds"))
    tiles = [
        ("succeeded", None if rate is None else _share(rate)),
        ("violated no bound", None if unbroken is None else _share(unbroken)),
        ("mean episode", None if lasted is None else f"{lasted:.1f} s"),
        ("samples", None if samples is None else _short(samples)),
        ("training", None if seconds is None else _duration(seconds)),
    ]
    return "".join(
        f'<div class="tile"><b>{escape(value)}</b><span>{name}</span></div>'
        for name, value in tiles
        if value is not None
    )


# ---------------------------------------------------------------------- sections


def _section(title: str, content: str) -> str:
    return f"<section><h2>{title}</h2>{content}</section>" if content else ""


def _motion(
    video: Path, outlines: np.ndarray | None, reference: np.ndarray | None, dt: float
) -> str:
    """The video, or the stick figure player in its place, and the filmstrip."""
    parts = []
    try:
        data = base64.b64encode(video.read_bytes()).decode()
        parts.append(
            '<div class="card"><video autoplay muted loop controls playsinline '
            f'src="data:video/mp4;base64,{data}"></video></div>'
        )
    except OSError:
        if outlines is not None and (player := stick_figure_animation(outlines, reference, dt)):
            parts.append(f'<div class="card">{player}</div>')
    if outlines is not None and (strip := stick_figure_svg(outlines, reference, dt)):
        parts.append(f'<div class="card strip">{strip}</div>')
    if outlines is not None and parts:
        names = ["learned"] if reference is None else ["learned", "reference"]
        key = "".join(f'<span class="key {name}">{name}</span>' for name in names)
        parts.append(f"<p>{key} Limbs on the far side are drawn fainter.</p>")
    return "".join(parts)


def _evaluation(evaluation: Row) -> str:
    """What the last evaluation found, and how often each bound was violated."""
    if not evaluation:
        return ""
    episodes, length = evaluation.get("episodes"), _number(evaluation.get("episode_seconds"))
    rate, lasted = (_number(evaluation.get(k)) for k in ("success_rate", "mean_episode_seconds"))
    unbroken, samples = (_number(evaluation.get(k)) for k in ("within_all_bounds", "samples"))
    rows = [
        ("Policy", evaluation.get("policy")),
        ("Samples learned from", None if samples is None else f"{samples:,.0f}"),
        ("Episodes", episodes),
        ("Longest possible", None if length is None else f"{length:g} s"),
        ("Mean length", None if lasted is None else f"{lasted:.2f} s"),
        ("Succeeded", None if rate is None else _share(rate)),
        ("95 % interval", _interval(evaluation) or None),
        ("Violated no bound", None if unbroken is None else _share(unbroken)),
    ]
    table = _table((name, escape(_text(value))) for name, value in rows if value is not None)
    violated = _table(
        (name, _bar(share))
        for name, value in _mapping(evaluation.get("violated")).items()
        if (share := _number(value)) is not None
    )
    if violated:
        violated = f"<div><h3>Episodes that violated a bound</h3>{violated}</div>"
    return f'<div class="card columns"><div><h3>All episodes</h3>{table}</div>{violated}</div>'


def _bar(share: float) -> str:
    width = 100 * min(max(share, 0.0), 1.0)
    return f'<span class="bar"><i style="width:{width:.1f}%"></i></span> {_share(share)}'


def _provenance(info: Row) -> str:
    """What is needed to repeat the run, and whom to credit."""
    facts = {
        "Created": info.get("created"),
        "Command": " ".join(map(_text, _sequence(info.get("command")))),
        "Overrides": " ".join(map(_text, _sequence(info.get("overrides")))),
        "Seed": _mapping(info.get("config")).get("seed"),
        **{str(k).capitalize(): v for k, v in _mapping(info.get("machine")).items()},
    }
    versions = _mapping(info.get("versions"))
    components = [_mapping(item) for item in _sequence(info.get("components"))]
    citations = "".join(f"<li>{escape(_text(c))}</li>" for c in _sequence(info.get("citations")))
    parts = {
        "Run": _table((k, escape(_text(v))) for k, v in facts.items() if v not in (None, "")),
        "Versions": _table((k, escape(_text(v))) for k, v in versions.items()),
        "Sources": "".join(
            f"<h4>{escape(_text(k))}</h4>{_nested(v)}"
            for k, v in _mapping(info.get("sources")).items()
        ),
        "Components": _components(components),
        "Please cite": f"<ul>{citations}</ul>" if citations else "",
    }
    cards = "".join(
        f'<div class="card"><h3>{title}</h3>{content}</div>'
        for title, content in parts.items()
        if content
    )
    return f'<div class="masonry">{cards}</div>' if cards else ""


def _components(components: Iterable[Row]) -> str:
    """Each part of the experiment with the plugin it is from."""
    return _table(
        (
            f"{_text(c.get('kind', ''))}/{_text(c.get('name', ''))}",
            f"{escape(_text(c.get('plugin', '')))} "
            f"<small>{escape(_text(c.get('distribution', '')))} {escape(_text(c.get('version', '')))}</small>",
        )
        for c in components
    )


def _nested(value: Any) -> str:
    """A value as escaped HTML; mappings as inner tables."""
    if isinstance(value, Mapping):
        return _table((k, _nested(v)) for k, v in value.items())
    return escape(_text(value))


def _configuration(info: Row) -> str:
    config = _mapping(info.get("config"))
    if not config:
        return ""
    # Through JSON, so that YAML has neither anchors for shared parts nor tags for odd types.
    plain = json.loads(json.dumps(config, default=str))
    text = yaml.safe_dump(plain, sort_keys=False, allow_unicode=True, width=88)
    return (
        '<details class="card"><summary>The composed configuration</summary>'
        f"<pre>{escape(text)}</pre></details>"
    )


def _table(rows: Iterable[tuple[Any, str]]) -> str:
    """A table of names and of values that are HTML already."""
    body = "".join(
        f'<tr><th scope="row">{escape(_text(name))}</th><td>{value}</td></tr>'
        for name, value in rows
    )
    return f"<table>{body}</table>" if body else ""


# ---------------------------------------------------------------------- learning curves


@dataclass(frozen=True)
class Chart:
    """What to draw of the metrics, against samples."""

    title: str
    key: str
    unit: str = ""
    low: float | None = None  #: the axis begins here; None: where the values do
    high: float | None = None
    cut: tuple[float, float] = (-math.inf, math.inf)  #: the axis never extends beyond


_CHARTS = (
    Chart("Episode length", "episode/episode_seconds", "s", low=0.0),
    Chart("Reward per step", "reward"),
    Chart("Explained variance of returns", "explained_variance", cut=(-1.0, 1.0)),
    Chart("KL divergence per update", "kl", low=0.0),
    Chart("Samples per second", "samples_per_second", low=0.0),
    Chart("Episodes that lasted to the end", "episode/truncated", "%", low=0.0, high=100.0),
)
_ENDED_BY = "episode/ended_by/"

#: Size of a chart and of the margins around its plot, in the SVG's own pixels.
_WIDTH, _HEIGHT = 340.0, 176.0
_LEFT, _RIGHT, _TOP, _BOTTOM = 44.0, 14.0, 8.0, 34.0
#: Long curves are drawn as means over this many stretches, in a band from least to greatest.
_STRETCHES = 120


def _learning(rows: Sequence[Row]) -> str:
    """A grid of learning curves: the usual ones, then why episodes ended."""
    terms = sorted({key for row in rows for key in row if key.startswith(_ENDED_BY)})
    endings = tuple(
        Chart(f"Ended by {key.removeprefix(_ENDED_BY)}", key, "%", low=0.0, high=100.0)
        for key in terms
    )
    usual = "".join(_chart(chart, rows) for chart in _CHARTS)
    ended = "".join(_chart(chart, rows) for chart in endings)
    if ended:
        ended = f'<h3>Why training episodes ended</h3><div class="charts">{ended}</div>'
    return (f'<div class="charts">{usual}</div>' if usual else "") + ended


def _chart(chart: Chart, rows: Sequence[Row]) -> str:
    """One learning curve as a card; nothing if no row has the value."""
    values = [(row.get("samples"), row[chart.key]) for row in rows if chart.key in row]
    numbers = [(_number(x), _number(y)) for x, y in values]
    points = np.array([(x, y) for x, y in numbers if x is not None and y is not None])
    if not values:
        return ""
    title, missing = escape(chart.title), len(values) - len(points)
    note = f"<small>{missing:,} not finite</small>" if missing else ""
    if not len(points):
        return f'<div class="card chart"><h4>{title}</h4>{note}</div>'
    if chart.unit == "%":
        points = points * [1, 100]
    unit = f" {chart.unit}" if chart.unit else ""
    last = f"{_short(points[-1, 1])}{unit}"
    return (
        f'<div class="card chart"><h4>{title}{note}<b>{escape(last)}</b></h4>'
        f"{_plot(points, *_range(points[:, 1], chart), label=f'{title} against samples')}</div>"
    )


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


def _plot(points: np.ndarray, low: float, high: float, label: str) -> str:
    """The SVG of one curve through `points` (n, 2) of samples and values; `label` is HTML."""
    end = float(max(points[:, 0].max(), 1.0))
    right, bottom = _WIDTH - _RIGHT, _HEIGHT - _BOTTOM

    def across(x: float) -> float:
        return _LEFT + (right - _LEFT) * max(x, 0.0) / end

    def down(y: float) -> float:
        return bottom - (bottom - _TOP) * (min(max(y, low), high) - low) / (high - low)

    parts = [
        f'<svg viewBox="0 0 {_WIDTH:g} {_HEIGHT:g}" role="img" aria-label="{label}" '
        'xmlns="http://www.w3.org/2000/svg">'
    ]
    ticks, step = _ticks(low, high, 4)
    for tick in ticks:
        y = down(tick)
        parts.append(
            f'<path class="grid" d="M{_LEFT:g} {y:.1f}H{right:g}"/>'
            f'<text x="{_LEFT - 6:g}" y="{y + 3.5:.1f}" text-anchor="end">{_label(tick, step)}</text>'
        )
    ticks, step = _ticks(0.0, end, 5)
    for tick in ticks:
        x = across(tick)
        parts.append(
            f'<path class="grid" d="M{x:.1f} {_TOP:g}V{bottom:g}"/>'
            f'<text x="{x:.1f}" y="{bottom + 14:g}" text-anchor="middle">{_label(tick, step)}</text>'
        )
    parts.append(
        f'<path class="axis" d="M{_LEFT:g} {_TOP:g}V{bottom:g}H{right:g}"/>'
        f'<text x="{(_LEFT + right) / 2:g}" y="{_HEIGHT - 5:g}" text-anchor="middle">samples</text>'
    )
    short = len(points) <= 2 * _STRETCHES
    stretches = np.array_split(points, len(points) if short else _STRETCHES)
    if len(stretches) == 1:
        x, y = points.mean(0)
        parts.append(f'<circle class="dot" cx="{across(x):.1f}" cy="{down(y):.1f}" r="3.5"/></svg>')
        return "".join(parts)
    if not short:
        upper = [(s[:, 0].mean(), s[:, 1].max()) for s in stretches]
        lower = [(s[:, 0].mean(), s[:, 1].min()) for s in reversed(stretches)]
        edge = "L".join(f"{across(x):.1f} {down(y):.1f}" for x, y in upper + lower)
        parts.append(f'<path class="band" d="M{edge}Z"/>')
    curve = "L".join(f"{across(x):.1f} {down(y):.1f}" for x, y in (s.mean(0) for s in stretches))
    parts.append(f'<path class="line" d="M{curve}"/></svg>')
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


# ---------------------------------------------------------------------- the page


def _security_policy() -> str:
    digest = base64.b64encode(hashlib.sha256(ANIMATION_SCRIPT.encode()).digest()).decode()
    return (
        "default-src 'none'; style-src 'unsafe-inline'; media-src data:; "
        f"script-src 'sha256-{digest}'; base-uri 'none'; form-action 'none'"
    )


_PAGE = Template("""<!doctype html>
<html lang="en">
<head>
<meta charset="utf-8">
<meta http-equiv="Content-Security-Policy" content="$policy">
<meta name="viewport" content="width=device-width, initial-scale=1">
<meta name="color-scheme" content="light dark">
<title>$task · understudy</title>
<style>$style</style>
</head>
<body>
<header>
<p class="over">understudy report<span>$created</span></p>
<h1>$task</h1>
<p class="headline">$headline</p>
<div class="tiles">$tiles</div>
</header>
<main>$sections</main>
</body>
</html>
""")

_STYLE = """
:root {
  --page: #f5f6f8; --card: #fff; --text: #171a21; --muted: #667080; --edge: #e2e5ea;
  --accent: #2563eb; --learned: #2563eb; --reference: #b4bcc8; --ground: #7b8594; --grid: #eceef2;
}
@media (prefers-color-scheme: dark) {
  :root {
    --page: #0f1218; --card: #181c24; --text: #e8eaef; --muted: #97a1b1; --edge: #2a303b;
    --accent: #6ea3ff; --learned: #6ea3ff; --reference: #565f6f; --ground: #97a1b1; --grid: #252b35;
  }
}
* { box-sizing: border-box; }
body {
  margin: 0 auto; max-width: 1240px; padding: 40px clamp(14px, 4vw, 48px) 64px;
  background: var(--page); color: var(--text); font: 15px/1.55 system-ui, sans-serif;
  overflow-wrap: anywhere;
}
h1 { margin: 2px 0 8px; font-size: clamp(26px, 5vw, 40px); line-height: 1.15; letter-spacing: -.02em; }
h2 { margin: 44px 0 14px; font-size: 20px; letter-spacing: -.01em; }
h3 { margin: 0 0 10px; font-size: 14px; color: var(--muted); font-weight: 600; }
table + h4 { margin-top: 16px; }
.charts + h3 { margin-top: 24px; }
h4 { display: flex; gap: 8px; align-items: baseline; margin: 0 0 6px; font-size: 13px; font-weight: 600; }
h4 b { margin-left: auto; white-space: nowrap; color: var(--accent); font-variant-numeric: tabular-nums; }
p { margin: 10px 0; color: var(--muted); font-size: 13px; }
small { color: var(--muted); font-size: 12px; font-weight: 400; }
.over { display: flex; flex-wrap: wrap; gap: 4px 16px; justify-content: space-between; margin: 0; }
.headline { margin: 0 0 22px; max-width: 62ch; color: var(--text); font-size: clamp(16px, 2.2vw, 19px); }
.tiles { display: grid; gap: 10px; grid-template-columns: repeat(auto-fit, minmax(128px, 1fr)); }
.tile, .card { background: var(--card); border: 1px solid var(--edge); border-radius: 12px; }
.tile { padding: 12px 16px; }
.tile b { display: block; font-size: 23px; line-height: 1.3; font-variant-numeric: tabular-nums; }
.tile span { color: var(--muted); font-size: 13px; }
.card { padding: 16px; }
.card + .card { margin-top: 14px; }
.charts .card, .masonry .card { margin-top: 0; }
.charts { display: grid; gap: 14px; grid-template-columns: repeat(auto-fill, minmax(min(100%, 310px), 1fr)); }
.chart { padding: 12px 12px 6px; }
svg { display: block; width: 100%; height: auto; }
.chart text { fill: var(--muted); font-size: 10.5px; font-variant-numeric: tabular-nums; }
.grid { stroke: var(--grid); }
.axis { stroke: var(--ground); fill: none; }
.line { stroke: var(--accent); fill: none; stroke-width: 1.8; stroke-linejoin: round; }
.band { fill: var(--accent); opacity: .18; }
.dot { fill: var(--accent); }
.strip { overflow-x: auto; }
.strip svg { min-width: 760px; }
video { display: block; width: 100%; max-height: 70vh; border-radius: 6px; background: #000; }
button { font: inherit; color: inherit; background: var(--page); border: 1px solid var(--edge);
  border-radius: 8px; padding: 4px 12px; cursor: pointer; }
input[type=range] { accent-color: var(--accent); }
.key::before { content: ""; display: inline-block; width: 18px; height: 5px; border-radius: 3px;
  margin-right: 6px; vertical-align: middle; background: var(--learned); }
.key.reference::before { background: var(--reference); }
.key { margin-right: 16px; }
.columns { display: grid; gap: 24px 40px; grid-template-columns: repeat(auto-fit, minmax(min(100%, 320px), 1fr)); }
.masonry { columns: 2 420px; column-gap: 14px; }
.masonry .card { break-inside: avoid; margin-bottom: 14px; }
table { width: 100%; border-collapse: collapse; font-size: 14px; }
th, td { padding: 5px 0; border-top: 1px solid var(--grid); text-align: left; vertical-align: top; }
tr:first-child > th, tr:first-child > td { border-top: 0; }
th { width: 44%; padding-right: 14px; color: var(--muted); font-weight: 400; }
td td, td th { padding: 2px 0; border: 0; }
td th { padding-right: 10px; }
.bar { display: inline-block; width: min(120px, 45%); height: 8px; margin-right: 8px; border-radius: 4px;
  background: var(--grid); overflow: hidden; vertical-align: 1px; }
.bar i { display: block; height: 100%; background: var(--accent); }
ul { margin: 0; padding-left: 18px; font-size: 14px; }
summary { cursor: pointer; font-weight: 600; }
pre { margin: 14px 0 0; overflow-x: auto; font: 12.5px/1.5 ui-monospace, monospace; }
"""
