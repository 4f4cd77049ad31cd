"""The texts and small pictures of the page's side panel, as HTML.

Clips and runs come from strangers: all of their text is escaped where it enters.
"""

from __future__ import annotations

from html import escape

import numpy as np

from understudy_viewer.figure import intervals
from understudy_viewer.stage import Actor, Colour, Stage

CONTACT: Colour = (16, 185, 129)
INSIDE: Colour = (100, 140, 150)
OUTSIDE: Colour = (220, 38, 38)

#: Columns of the strips over time.
_COLUMNS = 300
#: Longest text of a stranger that is shown.
_LONGEST = 160
_MARGIN = "margin:0 0.75em"
_SMALL = "font-size:0.75em;color:#667080"


def heading(stage: Stage) -> str:
    """Which figure is which motion, of what length, under what licence."""
    blocks = [_about(actor) for actor in stage.actors]
    blocks += [f'<div style="{_SMALL}">{_text(note)}</div>' for note in stage.notes]
    return f'<div style="{_MARGIN};line-height:1.35">{"".join(blocks)}</div>'


def clock(stage: Stage, frame: int) -> str:
    """The time and the number of the frame that is shown."""
    return (
        f'<div style="{_MARGIN};{_SMALL};display:flex;justify-content:space-between;'
        'font-variant-numeric:tabular-nums">'
        f"<span>{stage.times[frame]:.2f} of {stage.duration:.2f} s</span>"
        f"<span>frame {frame} of {len(stage.times) - 1}</span></div>"
    )


def contact_strips(stage: Stage, frame: int) -> str:
    """When each foot is on the ground, over the whole time, and where in it `frame` is."""
    now = stage.times[frame] / stage.duration
    rows = [
        _row(
            name.replace("_", " "),
            "",
            actor.colour,
            _strip(_columns(actor.figure.contacts[:, column], stage.times), CONTACT, now),
        )
        for actor in stage.actors
        for column, name in enumerate(actor.figure.feet)
    ]
    return f'<div style="{_MARGIN}">{"".join(rows)}</div>'


def gauges(stage: Stage, frame: int) -> str:
    """Each value of `frame` as a bar against its limit; below it when in the whole time it is beyond."""
    now = stage.times[frame] / stage.duration
    rows = []
    for gauge in stage.gauges:
        value, limit = float(gauge.values[frame]), float(gauge.limits[frame])
        share = _share(value, limit)
        beyond = _columns(gauge.values > gauge.limits, stage.times)
        bar = (
            '<div style="height:6px;border-radius:3px;background:#e2e5ea;overflow:hidden">'
            f'<div style="height:100%;width:{100 * min(share, 1.0):.1f}%;'
            f'background:{css(OUTSIDE if share > 1.0 else INSIDE)}"></div></div>'
        )
        figures = f"{value:.2f} of {limit:.2f} {_text(gauge.unit)}"
        rows.append(_row(gauge.name, figures, None, bar + _strip(beyond, OUTSIDE, now)))
    return f'<div style="{_MARGIN}">{"".join(rows)}</div>'


def css(colour: Colour) -> str:
    """The colour as CSS says it."""
    return "#{:02x}{:02x}{:02x}".format(*colour)


def _about(actor: Actor) -> str:
    clip, role = actor.subject.clip, actor.subject.role
    facts = [
        f"{clip.num_frames} frames",
        f"{clip.duration:.2f} s",
        f"{clip.frame_rate:.4g} frames/s",
        *(["loops"] if clip.loop else []),
    ]
    lines = [" · ".join(facts), f"licence: {_text(clip.licence)}", _text(clip.attribution)]
    below = "".join(f'<div style="{_SMALL}">{line}</div>' for line in lines if line)
    return (
        f'<div style="margin-bottom:0.5em">{_chip(actor.colour)}<b>{_text(clip.name)}</b> '
        f'<span style="{_SMALL}">{_text(role)}</span>{below}</div>'
    )


def _row(name: str, right: str, colour: Colour | None, picture: str) -> str:
    chip = "" if colour is None else _chip(colour)
    return (
        f'<div style="margin-bottom:0.5em"><div style="{_SMALL};display:flex;'
        'justify-content:space-between;font-variant-numeric:tabular-nums">'
        f"<span>{chip}{_text(name)}</span><span>{right}</span></div>{picture}</div>"
    )


def _chip(colour: Colour) -> str:
    return (
        '<span style="display:inline-block;width:0.7em;height:0.7em;border-radius:50%;'
        f'margin-right:0.4em;background:{css(colour)}"></span>'
    )


def _strip(columns: np.ndarray, colour: Colour, now: float) -> str:
    """An SVG that is coloured in the `columns` (C,) bool that hold, with a line at the share `now`."""
    bars = "".join(f"M{a} 0H{b}V8H{a}Z" for a, b in intervals(columns).tolist())
    return (
        f'<svg viewBox="0 0 {len(columns)} 8" preserveAspectRatio="none" '
        'style="display:block;width:100%;height:8px;margin-top:2px">'
        f'<rect width="{len(columns)}" height="8" fill="#eceef2"/>'
        f'<path d="{bars}" fill="{css(colour)}"/>'
        f'<rect x="{now * len(columns) - 0.75:.2f}" width="1.5" height="8" fill="#171a21"/></svg>'
    )


def _columns(on: np.ndarray, times: np.ndarray) -> np.ndarray:
    """Whether `on` (F,) holds anywhere in each of the columns, into which the time is divided."""
    middles = (np.arange(_COLUMNS) + 0.5) / _COLUMNS * times[-1]
    columns = on[np.searchsorted(times, middles, side="right") - 1]
    within = np.minimum(times / times[-1] * _COLUMNS, _COLUMNS - 1).astype(int)
    columns[within[on]] = True  # a single frame may be less than a column
    return columns


def _share(value: float, limit: float) -> float:
    """Of the limit; beyond it more than 1, even if it is 0."""
    return value / max(limit, 1e-9)


def _text(text: str) -> str:
    shown = text if len(text) <= _LONGEST else f"{text[:_LONGEST]}…"
    return escape("".join(filter(str.isprintable, shown)))
