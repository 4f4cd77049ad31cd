"""An examination as a page: one HTML file that needs nothing else, not even the network.

Names may come from strangers, so all text is escaped where it enters the page, and the page's
security policy allows no script. Every finding links to its place in a chart, and back.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from html import escape

import numpy as np

from understudy_characters.heads import head_body, ring
from understudy_doctor.character_checks import JOINT_FINDINGS, TORQUE, UNEXPLAINED, excesses
from understudy_doctor.clip_checks import speeds
from understudy_doctor.examination import Examination
from understudy_doctor.findings import Finding, Severity
from understudy_doctor.measurements import Measurements
from understudy_doctor.summary import contacts, torques, verdict
from understudy_motion.kinematics import tip_positions
from understudy_report.page import bare_page
from understudy_report.stick_figures import stick_figure_svg

#: Of a chart, in the SVG's own pixels: its width, of that the labels and the values beside the rows,
#: the gap between rows, and the height of the axis.
_WIDTH, _LABELS, _VALUES, _GAP, _AXIS = 1000.0, 118.0, 76.0, 5.0, 22.0
_POINTS = 800  # of a curve; a longer one shows the extreme of each stretch

#: By kind of finding: the chart that shows it. Kinds not listed have no place in time.
_CHART_OF: Mapping[str, str] = {
    "ground_offset": "heights", "penetration": "heights", "float": "heights",
    "foot_skate": "contacts", "unsupported": "support", "torque": "torque",
    "joint_limit": "limits", "joint_axis": "limits", "joint_range": "limits",
    "spike": "speeds", "speed": "speeds", "seam_pose": "speeds", "seam_velocity": "speeds", "frame_rate": "speeds",
    "uneven_frames": "speeds", "duplicate_frames": "speeds",
}  # fmt: skip


def page(examined: Examination, repairs: Sequence[str] = ()) -> bytes:
    """The page of an examination; `repairs` are what was done to the clip before it, in words."""
    clip = examined.clip
    numbered = list(enumerate(examined.findings))
    charts = list(_charts(examined))
    content = (
        f"<p>{escape(f'{clip.source} · licence: {clip.licence}')}</p>"
        f'<p class="verdict">{escape(verdict(examined.findings))}</p>'
        f'<div class="tiles">{_tiles(examined)}</div>'
        f"{_list('Repaired', repairs)}"
        f"<section><h2>Findings</h2>{_findings(numbered, {chart.key for chart in charts})}</section>"
        f"{_poses(examined)}{''.join(_draw(chart, clip.duration, numbered) for chart in charts)}"
        f"{_joints(examined)}{_list('Not checked', examined.skipped)}"
    )
    return bare_page(clip.name, "understudy clip check", "", content, _STYLE)


# ---------------------------------------------------------------------- the result


def _tiles(examined: Examination) -> str:
    clip = examined.clip
    count = {level: sum(f.severity == level for f in examined.findings) for level in Severity}
    tiles = [
        (str(count[Severity.MAJOR]), "major findings"),
        (str(count[Severity.MINOR]), "minor findings"),
        (f"{clip.duration:.2f} s", "loops" if clip.loop else "does not loop"),
        (f"{clip.frame_rate:.4g}", f"frames/s, {clip.num_frames} frames"),
        (examined.character.name if examined.character else "–", "character"),
    ]
    return "".join(
        f'<div class="tile"><b>{escape(value)}</b><span>{escape(name)}</span></div>'
        for value, name in tiles
    )


def _findings(numbered: Sequence[tuple[int, Finding]], charts: set[str]) -> str:
    if not numbered:
        return '<div class="card">Nothing is wrong with this clip.</div>'
    rows = []
    for number, found in numbered:
        when = found.when
        if _CHART_OF.get(found.kind) in charts:
            when = f'<a href="#place-{number}">{when}</a>'
        rows.append(
            f'<tr id="finding-{number}"><td><span class="badge {found.severity}">'
            f"{found.severity}</span></td><td class='kind'><b>{escape(found.kind)}</b><br>"
            f"{escape(', '.join(found.joints))}</td><td class='when'>{when}<br>"
            f"<small>{found.frames}</small></td>"
            f"<td>{escape(found.what)}.<br><small>{escape(found.remedy)}</small></td></tr>"
        )
    return f'<div class="card wide"><table>{"".join(rows)}</table></div>'


def _poses(examined: Examination) -> str:
    """A strip of stick figures."""
    measured = examined.measured
    if measured is None:
        return ""
    positions = measured.kinematics[0].numpy()
    skeleton = measured.character.skeleton
    rows = range(1, len(skeleton.parents))
    segments = [positions[:, [skeleton.parents[row], row]] for row in rows]
    ends = _tips(measured)
    outlines = np.stack([*segments, *ends], axis=1)
    character, starts = measured.character, [*measured.character.skeleton.tips]
    body = head_body(character)
    head = None if body is None else character.joint_names[character.carrier[body]]
    if head in starts:
        top = ends[starts.index(head)].mean(axis=1)
        outlines = np.concatenate([outlines, ring(top, character.length)], axis=1)
    strip = stick_figure_svg(outlines, None, measured.dt, poses=14)
    return f'<section><h2>Poses</h2><div class="card strip">{strip}</div></section>'


def _tips(measured: Measurements) -> list[np.ndarray]:
    """Segments (F, 2, 3) from the last joints to the tips of what they carry."""
    positions, world = measured.kinematics
    tips = tip_positions(measured.figure, positions, world).numpy()
    names = measured.figure.joint_names
    starts = [names.index(name) for name in measured.character.skeleton.tips]
    return [
        np.stack([positions[:, row].numpy(), tips[:, column]], axis=1)
        for column, row in enumerate(starts)
    ]


# ---------------------------------------------------------------------- charts over time


@dataclass(frozen=True)
class Row:
    """One line of a chart: a curve, or filled stretches of time."""

    label: str
    times: np.ndarray  #: (n,) s
    values: np.ndarray | None = None  #: (n,)
    spans: Sequence[tuple[float, float]] = ()  #: s
    value: str = ""  #: beside the row


@dataclass(frozen=True)
class Chart:
    """Rows over one axis of time, from `low` to `high`, with a line at `mark`."""

    key: str
    title: str
    note: str
    rows: Sequence[Row]
    low: float = 0.0
    high: float = 1.0
    mark: float | None = None
    height: float = 26.0


def _charts(examined: Examination) -> Iterator[Chart]:
    measured = examined.measured
    if measured is not None:
        yield from _ground_charts(examined, measured)
    clip = examined.clip
    speed = np.linalg.norm(speeds(clip), axis=-1)
    times = clip.times.numpy()
    middle = 0.5 * (times[1:] + times[:-1])
    yield Chart(
        "speeds",
        "Joint speeds",
        "How fast each joint turns against its parent, all to one scale; the greatest is at the right.",
        [
            Row(name, middle, column, value=f"{column.max():.1f} rad/s")
            for name, column in zip(clip.joint_names, speed.T, strict=True)
        ],
        high=max(float(np.quantile(speed, 0.999)), 1.0),
    )
    if measured is not None:
        yield from _effort_charts(measured)


def _ground_charts(examined: Examination, measured: Measurements) -> Iterator[Chart]:
    names = measured.character.joint_names
    yield Chart(
        "contacts",
        "Contacts",
        "When joints touch the ground, estimated from how high and how fast their lowest points are.",
        [
            Row(joint, measured.times, spans=spans, value=f"{len(spans)}×")
            for joint, spans in contacts(examined).items()
        ],
    )
    lowest = 100.0 * measured.heights.min(1)
    curves = {names[foot]: 100.0 * measured.heights[:, foot] for foot in measured.feet}
    low = min(-5.0, *(float(curve.min()) for curve in (*curves.values(), lowest)))
    yield Chart(
        "heights",
        "Heights",
        "The lowest point of each foot, and of the whole body, above z = 0, in cm.",
        [
            Row(label, measured.times, curve, value=f"{curve.min():+.1f} cm")
            for label, curve in (*curves.items(), ("whole body", lowest))
        ],
        low=low,
        high=max(30.0, min(float(max(c.max() for c in curves.values())), 60.0)),
        mark=0.0,
        height=58.0,
    )
    over = [
        Row(
            names[e.joint], measured.times, np.maximum(e.over, 0.0), value=f"{e.over.max():.2f} rad"
        )
        for e in excesses(measured)
        if e.over.max() > JOINT_FINDINGS[e.kind][0]
    ]
    if over:
        most = max(float(row.values.max()) for row in over if row.values is not None)
        yield Chart(
            "limits",
            "Beyond the joints’ ranges",
            "By how much: hinges beyond their limits or off their axes, balls beyond human ranges.",
            over,
            high=most,
        )


def _effort_charts(measured: Measurements) -> Iterator[Chart]:
    support = measured.support
    yield Chart(
        "support",
        "Unexplained force",
        "What acts on the body though nothing can push there, in weights of the character.",
        [
            Row("whole body", measured.times, support.unexplained,
                value=f"{support.unexplained.max():.1f}")
        ],
        high=max(1.0, float(support.unexplained.max())),
        mark=UNEXPLAINED,
        height=58.0,
    )  # fmt: skip
    known = [
        (name, share)
        for name, share in zip(measured.character.joint_names, support.share.T, strict=True)
        if np.isfinite(share).all()
    ]
    if known:
        yield Chart(
            "torque",
            "Torque demand",
            "By inverse dynamics of the smoothed motion; the line is the joint’s limit.",
            [Row(n, measured.times, s, value=f"{100 * s.max():.0f} %") for n, s in known],
            high=max(1.25, min(3.0, max(float(s.max()) for _, s in known))),
            mark=TORQUE,
        )


def _draw(chart: Chart, seconds: float, numbered: Sequence[tuple[int, Finding]]) -> str:
    """The chart as a section, with the places of its findings."""
    right, step = _WIDTH - _VALUES, chart.height + _GAP
    bottom = len(chart.rows) * step

    def across(time: float) -> float:
        return _LABELS + (right - _LABELS) * min(max(time / seconds, 0.0), 1.0)

    parts = [
        f'<svg viewBox="0 0 {_WIDTH:g} {bottom + _AXIS:g}" role="img" '
        f'aria-label="{escape(chart.title)}" xmlns="http://www.w3.org/2000/svg">'
    ]
    for tick in _ticks(seconds):
        parts.append(
            f'<path class="grid" d="M{across(tick):.1f} 0V{bottom:g}"/>'
            f'<text x="{across(tick):.1f}" y="{bottom + 14:g}" text-anchor="middle">{tick:g} s</text>'
        )
    tops = {}
    for index, row in enumerate(chart.rows):
        top = tops.setdefault(row.label, index * step)
        middle = index * step + 0.5 * chart.height + 4.0
        parts.append(
            f'<rect class="lane" x="{_LABELS:g}" y="{index * step:g}" '
            f'width="{right - _LABELS:g}" height="{chart.height:g}"/>'
            f'<text x="{_LABELS - 8:g}" y="{middle:g}" text-anchor="end">{escape(row.label)}</text>'
            f'<text x="{right + 8:g}" y="{middle:g}">{escape(row.value)}</text>'
        )
        for start, stop in row.spans:
            parts.append(
                f'<rect class="span" x="{across(start):.1f}" y="{top + 5:g}" rx="2" '
                f'width="{max(across(stop) - across(start), 2.0):.1f}" height="{chart.height - 10:g}"/>'
            )
        if row.values is not None:
            parts.append(_curve(chart, row, index * step, across))
    for number, found in numbered:
        if _CHART_OF.get(found.kind) != chart.key:
            continue
        at = [tops[name] for name in found.joints if name in tops] or [0.0]
        tall = chart.height if found.joints else bottom - _GAP
        for place, top in enumerate(at):
            name = f'id="place-{number}" ' if place == 0 else ""
            left = across(found.start) - 2.0
            parts.append(
                f'<a href="#finding-{number}"><rect {name}class="place {found.severity}" '
                f'x="{left:.1f}" y="{top:g}" width="{across(found.stop) + 2.0 - left:.1f}" '
                f'height="{tall:g}" rx="2"><title>{escape(found.line())}</title></rect></a>'
            )
    parts.append("</svg>")
    return (
        f'<section><h2>{escape(chart.title)}</h2><div class="card chart">{"".join(parts)}</div>'
        f"<p>{escape(chart.note)}</p></section>"
    )


def _curve(chart: Chart, row: Row, top: float, across: Callable[[float], float]) -> str:
    """The row's curve, filled to the axis where that begins at 0."""
    assert row.values is not None
    times, values = row.times, row.values
    if len(values) > _POINTS:
        parts = np.array_split(np.arange(len(values)), _POINTS)
        extreme = [part[np.abs(values[part]).argmax()] for part in parts]
        times, values = times[extreme], values[extreme]
    inner = chart.height - 2.0

    def down(value: float) -> float:
        share = (min(max(value, chart.low), chart.high) - chart.low) / (chart.high - chart.low)
        return top + 1.0 + inner * (1.0 - share)

    points = "L".join(f"{across(t):.1f} {down(v):.1f}" for t, v in zip(times, values, strict=True))
    drawn = f'<path class="line" d="M{points}"/>'
    if chart.low == 0.0:
        ends = f"L{across(times[-1]):.1f} {down(0.0):.1f}L{across(times[0]):.1f} {down(0.0):.1f}Z"
        drawn = f'<path class="area" d="M{points}{ends}"/>{drawn}'
    if chart.mark is not None:
        mark = f"M{_LABELS:g} {down(chart.mark):.1f}H{_WIDTH - _VALUES:g}"
        drawn += f'<path class="mark" d="{mark}"/>'
    return drawn


def _ticks(seconds: float) -> list[float]:
    """Round times from 0 to `seconds`, at most about ten."""
    step = next(s for s in (*_STEPS, seconds) if seconds / s <= 10.0)
    return [round(i * step, 6) for i in range(int(seconds / step + 1e-9) + 1)]


_STEPS = (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0, 5.0, 10.0, 20.0, 60.0, 120.0, 300.0, 600.0)


# ---------------------------------------------------------------------- tables


def _joints(examined: Examination) -> str:
    """Of each joint: how much of its range the clip uses, and its peak torque."""
    measured = examined.measured
    if measured is None:
        return ""
    qpos = measured.qpos.numpy()
    demand = torques(examined)
    rows = []
    for joint in measured.character.joints[1:]:
        used = "".join(
            _range_bar(qpos[:, address], *limits)
            for address, limits in zip(joint.addresses, joint.ranges.tolist(), strict=False)
        )
        torque = demand[joint.name]
        bar = "" if torque["share"] is None else _bar(torque["share"])
        rows.append(
            f'<tr><th scope="row">{escape(joint.name)}</th><td>{used or "ball, free"}</td>'
            f"<td>{torque['peak']:.0f} N m {bar}</td></tr>"
        )
    return (
        '<section><h2>Joints</h2><div class="card wide"><table><tr><th>joint</th>'
        "<th>range used (dark) of what it has</th><th>peak torque, and its share of the limit</th></tr>"
        f"{''.join(rows)}</table></div></section>"
    )


def _range_bar(angles: np.ndarray, low: float, high: float) -> str:
    least, most = np.degrees([angles.min(), angles.max()])
    words = f"{least:.0f}° to {most:.0f}°"
    if not np.isfinite([low, high]).all():
        return f"{words}, no limit"
    low, high = np.degrees([low, high])
    first, last = min(low, least), max(high, most)

    def share(angle: float) -> float:
        return 100.0 * (angle - first) / max(last - first, 1e-9)

    over = " over" if least < low - 1.0 or most > high + 1.0 else ""
    return (
        f'<span class="bar"><i class="has" style="left:{share(low):.1f}%;'
        f'width:{share(high) - share(low):.1f}%"></i><i class="used{over}" '
        f'style="left:{share(least):.1f}%;width:{share(most) - share(least):.1f}%"></i></span> '
        f"{words} of {low:.0f}° to {high:.0f}°"
    )


def _bar(share: float) -> str:
    over = " over" if share > 1.0 else ""
    return (
        f'<span class="bar"><i class="has" style="left:0;width:{100 / max(share, 1.0):.1f}%"></i>'
        f'<i class="used{over}" style="left:0;width:{100 * min(share, 1.0):.1f}%"></i></span> '
        f"{100 * share:.0f} %"
    )


def _list(title: str, items: Sequence[str]) -> str:
    if not items:
        return ""
    rows = "".join(f"<li>{escape(item)}</li>" for item in items)
    return f'<section><h2>{title}</h2><div class="card"><ul>{rows}</ul></div></section>'


# ---------------------------------------------------------------------- the page


_STYLE = """
:root {
  --page: #f5f6f8; --card: #fff; --text: #171a21; --muted: #667080; --edge: #e2e5ea; --lane: #f4f5f8;
  --accent: #2563eb; --learned: #2563eb; --ground: #7b8594; --grid: #e2e5ea;
  --major: #d92d20; --minor: #d97706;
}
@media (prefers-color-scheme: dark) {
  :root {
    --page: #0f1218; --card: #181c24; --text: #e8eaef; --muted: #97a1b1; --edge: #2a303b;
    --lane: #1f242e; --accent: #5b8cf5; --learned: #3f7af0; --ground: #97a1b1; --grid: #2a303b;
    --major: #ff6b5e; --minor: #f5a524;
  }
}
* { box-sizing: border-box; }
html { scroll-behavior: smooth; }
body { margin: 0 auto; max-width: 1180px; padding: 36px clamp(14px, 4vw, 44px) 64px;
  background: var(--page); color: var(--text); font: 15px/1.5 system-ui, sans-serif;
  overflow-wrap: anywhere; }
h1 { margin: 0 0 4px; font-size: clamp(26px, 5vw, 38px); line-height: 1.15; letter-spacing: -.02em; }
h2 { margin: 34px 0 12px; font-size: 19px; letter-spacing: -.01em; }
p { margin: 6px 0; color: var(--muted); font-size: 13px; }
small { color: var(--muted); font-size: 12.5px; }
.verdict { margin: 14px 0; color: var(--text); font-size: 18px; }
.tiles { display: grid; gap: 10px; grid-template-columns: repeat(auto-fit, minmax(140px, 1fr)); }
.tile, .card { background: var(--card); border: 1px solid var(--edge); border-radius: 12px; }
.tile { padding: 10px 16px; }
.tile b { display: block; font-size: 22px; font-variant-numeric: tabular-nums; }
.tile span { color: var(--muted); font-size: 13px; }
.card { padding: 14px 16px; }
.wide, .strip, .chart { overflow-x: auto; }
.strip svg, .chart svg { display: block; width: 100%; min-width: 720px; height: auto; }
table { width: 100%; border-collapse: collapse; font-size: 14px; }
th, td { padding: 7px 14px 7px 0; border-top: 1px solid var(--edge); text-align: left; vertical-align: top; }
tr:first-child > * { border-top: 0; }
th { color: var(--muted); font-weight: 400; }
tr:target { background: color-mix(in srgb, var(--accent) 14%, transparent); }
.kind b { white-space: nowrap; }
.when { white-space: nowrap; font-variant-numeric: tabular-nums; }
a { color: var(--accent); }
.badge { white-space: nowrap; padding: 1px 9px; border-radius: 99px; color: var(--card); font-size: 12.5px; font-weight: 600; }
.badge.major { background: var(--major); }
.badge.minor { background: var(--minor); }
.chart text { fill: var(--muted); font-size: 12px; font-variant-numeric: tabular-nums; }
.grid { stroke: var(--grid); }
.lane { fill: var(--lane); }
.span { fill: var(--accent); opacity: .75; }
.line { fill: none; stroke: var(--accent); stroke-width: 1.4; stroke-linejoin: round; }
.area { fill: var(--accent); opacity: .16; }
.mark { fill: none; stroke: var(--ground); stroke-dasharray: 4 3; }
.place { fill-opacity: .22; stroke-width: 1; stroke-opacity: .7; }
.place.major { fill: var(--major); stroke: var(--major); }
.place.minor { fill: var(--minor); stroke: var(--minor); }
.place:target, .place:hover { fill-opacity: .45; stroke-width: 3; stroke-opacity: 1; }
.place { scroll-margin-top: 30vh; }
.bar { position: relative; display: inline-block; width: 150px; height: 9px; margin-right: 8px;
  border-radius: 5px; background: var(--lane); overflow: hidden; }
.bar i { position: absolute; top: 0; height: 100%; }
.has { background: color-mix(in srgb, var(--accent) 28%, transparent); }
.used { background: var(--accent); }
.used.over { background: var(--major); }
ul { margin: 0; padding-left: 18px; }
@media (max-width: 600px) {
  body { padding-top: 20px; }
  .card { padding: 10px 12px; }
  .strip svg, .chart svg { min-width: 560px; }
  .wide table, .wide tbody, .wide tr, .wide td { display: block; }
  .wide tr + tr { margin-top: 10px; border-top: 1px solid var(--edge); padding-top: 8px; }
  .wide td { padding: 2px 0; border: 0; }
  .wide th { display: none; }
  .bar { width: 110px; }
}
"""
