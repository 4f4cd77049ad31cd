"""Stick figures as SVG: a filmstrip and a player, for pages that need nothing else.

Stick figures are line segments in metres, world frame, z up. They are seen from the side: x to the
right, z up, y away from the viewer; segments on the far side of the body are drawn fainter.
"""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np

__all__ = ["stick_figure_animation", "stick_figure_svg"]

#: Metres. What lies farther from the origin comes from a simulation that blew up.
_FARTHEST = 1e4
#: Colours of the two figures, as in videos, and of the ground; a page may set the variables.
_LEARNED = "var(--learned, #2563eb)"
_REFERENCE = "var(--reference, #f59e40)"
_GROUND = "var(--ground, #8a93a0)"
#: Millimetres between the marks on the animation's ground.
_MARKS = 500
#: Plays the figure it stands in. It is the same for every motion, so a page's security policy can
#: allow it by its digest.
PLAYER_SCRIPT = (Path(__file__).parent / "player.js").read_text(encoding="utf-8")


def stick_figure_svg(
    outlines: np.ndarray,
    reference: np.ndarray | None,
    dt: float,
    *,
    poses: int = 10,
    height: float = 200.0,
) -> str:
    """A filmstrip: evenly spaced poses side by side, over the pose of the reference at that time.

    Parameters
    ----------
    outlines
        (T, S, 2, 3) m, the learned motion.
    reference
        (T, S, 2, 3) m, the motion it should follow, or None.
    dt
        Seconds between frames.
    poses
        The most poses drawn.
    height
        Height of the drawing in pixels of the SVG's own scale; the page may scale it.

    Returns
    -------
    str
        An ``<svg>`` element, or nothing if there is no pose to draw.
    """
    outlines, reference = _checked(outlines, reference)
    if not outlines.size:
        return ""
    chosen = np.unique(np.linspace(0, len(outlines) - 1, poses).round().astype(int))
    centres = _centres(outlines)
    body = outlines[chosen] - centres[chosen, None, None, :] * [1, 0, 0]
    top = _top(body)
    # Wide enough for the widest pose, within limits that keep the strip a strip.
    reach = np.nanmax(np.abs(body[..., 0]), initial=0.0)
    cell = 2 * float(np.clip(reach + 0.08 * top, 0.28 * top, 0.9 * top))
    scale = (height - 40.0) / top
    width = cell * scale
    ground = height - 28.0
    total = width * len(chosen)
    parts = [
        f'<svg viewBox="0 0 {total:.1f} {height:g}" role="img" xmlns="http://www.w3.org/2000/svg" '
        f'aria-label="Poses of the learned motion over time">'
    ]
    for place, frame in enumerate(chosen):
        # Nested <svg> elements clip: a reference that is far away does not cross other poses.
        parts.append(
            f'<svg x="{place * width:.1f}" y="0" width="{width:.1f}" height="{height:g}">'
            f'<g transform="translate({width / 2:.1f} {ground:g}) scale({scale / 1000:.6f})">'
        )
        figures = [] if reference is None else [(reference[frame], _REFERENCE)]
        for segments, colour in [*figures, (outlines[frame], _LEARNED)]:
            far, near = _paths(segments, centres[frame])
            parts.append(_stroke(far, colour, top, 0.5) + _stroke(near, colour, top, 1.0))
        parts.append(
            f'</g><text x="{width / 2:.1f}" y="{height - 8:g}" text-anchor="middle" '
            f'font-size="12" style="fill:{_GROUND}">{frame * dt:.1f} s</text></svg>'
        )
    parts.append(
        f'<path d="M0 {ground + 2:g}H{total:.1f}" stroke-width="1.5" style="stroke:{_GROUND}"/></svg>'
    )
    return "".join(parts)


def stick_figure_animation(outlines: np.ndarray, reference: np.ndarray | None, dt: float) -> str:
    """A player of the motion: SVG, a button, a slider, and :data:`PLAYER_SCRIPT`.

    Parameters
    ----------
    outlines
        (T, S, 2, 3) m, the learned motion.
    reference
        (T, S, 2, 3) m, or None.
    dt
        Seconds between frames.

    Returns
    -------
    str
        An HTML ``<figure>`` element, or nothing if there is nothing to play.
    """
    outlines, reference = _checked(outlines, reference)
    if not outlines.size:
        return ""
    centres = _centres(outlines)
    top = _top(outlines)
    frames = []
    for index, centre in enumerate(centres):
        goal = ("", "") if reference is None else _paths(reference[index], centre)
        frames.append([*goal, *_paths(outlines[index], centre), round(centre[0] * 1000)])
    data = json.dumps(
        {"dt": round(dt, 6), "marks": _MARKS, "frames": frames}, separators=(",", ":")
    )
    up, side = round(1000 * top * 1.08), round(1000 * top * 1.2)
    marks = "".join(f"M{x} 12v40" for x in range(-side - _MARKS, side + 2 * _MARKS, _MARKS))
    shown = frames[0]
    strokes = "".join(
        _stroke(path, colour, top, opacity)
        for path, colour, opacity in zip(
            shown[:4],
            (_REFERENCE, _REFERENCE, _LEARNED, _LEARNED),
            (0.5, 1.0, 0.5, 1.0),
            strict=True,
        )
    )
    return f"""<figure class="player" style="margin:0">
<svg viewBox="{-side} {-up} {2 * side} {up + 90}" role="img" xmlns="http://www.w3.org/2000/svg"
 aria-label="The learned motion" style="display:block;width:100%;max-height:480px">
<g style="stroke:{_GROUND};stroke-width:12"><path d="M{-side} 12H{side}"/><path class="marks" d="{marks}"/></g>
<g class="figures">{strokes}</g></svg>
<div style="display:flex;gap:12px;align-items:center;padding:8px 12px">
<button type="button" style="min-width:5em">Play</button>
<input type="range" min="0" max="{len(frames) - 1}" value="0" style="flex:1;min-width:0" aria-label="Frame">
<output style="min-width:4em;text-align:right;font-variant-numeric:tabular-nums">0.00 s</output>
</div>
<script type="application/json">{data}</script>
<script>{PLAYER_SCRIPT}</script>
</figure>"""


def _checked(
    outlines: np.ndarray, reference: np.ndarray | None
) -> tuple[np.ndarray, np.ndarray | None]:
    """Both as float64 (T, S, 2, 3), with NaN in the segments that cannot be drawn."""
    outlines = np.array(outlines, dtype=np.float64)
    figures = [outlines]
    if reference is not None:
        reference = np.array(reference, dtype=np.float64)
        figures.append(reference)
    for figure in figures:
        if figure.ndim != 4 or figure.shape[2:] != (2, 3) or len(figure) != len(outlines):
            raise ValueError(f"stick figures are (T, S, 2, 3), not {[f.shape for f in figures]}")
        drawable = (np.abs(figure) < _FARTHEST).all((2, 3))
        figure[~drawable] = np.nan
    return outlines, reference


def _centres(outlines: np.ndarray) -> np.ndarray:
    """The middle of each figure, (T, 3) m; the origin where there is nothing to draw."""
    points = outlines.reshape(len(outlines), -1, 3)
    count = np.isfinite(points[..., 0]).sum(1)
    return np.nansum(points, axis=1) / np.maximum(count, 1)[:, None]


def _top(outlines: np.ndarray) -> float:
    """Metres from the ground to the highest point, at least 10 cm."""
    return max(0.1, float(np.nanmax(outlines[..., 2], initial=0.1)))


def _paths(segments: np.ndarray, centre: np.ndarray) -> tuple[str, str]:
    """SVG paths of the far and of the near `segments` (S, 2, 3), in millimetres around `centre`."""
    drawable = segments[np.isfinite(segments).all((1, 2))]
    # A margin keeps the spine near, however the figure sways.
    far = drawable[..., 1].mean(1) > centre[1] + 0.03
    across = np.round((drawable[..., 0] - centre[0]) * 1000).astype(int)
    down = np.round(-drawable[..., 2] * 1000).astype(int)
    far_path, near_path = (
        "".join(
            f"M{xs[0]} {zs[0]}L{xs[1]} {zs[1]}"
            for xs, zs in zip(across[side], down[side], strict=True)
        )
        for side in (far, ~far)
    )
    return far_path, near_path


def _stroke(path: str, colour: str, top: float, opacity: float) -> str:
    """The element of a path in millimetres, about as thick as the limbs of a figure `top` high."""
    return (
        f'<path d="{path}" fill="none" stroke-linecap="round" stroke-width="{28 * top:.0f}" '
        f'opacity="{opacity:g}" style="stroke:{colour}"/>'
    )
