"""Whether a clip's travel is that of a body with longer or shorter legs.

A foot that stands pushes the body along as far as it reaches: with the poses of the clip, legs s times
as long carry the root s times as far and s times as high. Scaled so, in a time √s as long, a motion
stays what it was under the same gravity, flights on their parabolas included (dynamic similarity:
Alexander, "The Gaits of Bipedal and Quadrupedal Animals", IJRR 3(2), 1984; Hodgins and Pollard,
"Adapting Simulated Behaviors For New Characters", SIGGRAPH 1997, section 4).
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from understudy_doctor.findings import Finding, Places, severity
from understudy_doctor.measurements import Measurements
from understudy_motion.clip import Clip

LEGS, LEGS_MAJOR = 0.08, 0.15
"""Relative difference in length: a little more than what captured clips tell of their own body, and what
puts a standing foot, or a step, off by more than a foot's width."""
LARGEST = 2.0
"""Legs that differ more, either way, are another creature's."""
AGREE = 0.1
"""Relative difference between the scales that height and travel tell of the same legs: 7 % in captured
clips on the body that they were fitted to."""

_TRAVEL = 0.4  # m that the root goes over standing feet, before its travel tells anything
_FAR = 2.0  # m: then it tells enough, wherever the floor of the clip is
_CROUCH = 0.12  # m by which its height changes there, before that tells anything without travel
_LEVEL = 0.03  # m: floors are level to this
_SLIP = 0.15  # share of the travel that feet may slip beside what the scale explains


def leg_scale(measured: Measurements) -> float:
    """How many times as long as the clip's legs the character's are; 1 where they are the same, or
    where the clip does not tell."""
    root = measured.clip.root_position.numpy()
    feet = list(measured.feet)
    lowest = measured.heights.argmin(1)
    carrying = measured.supported & np.isin(lowest, feet)
    same = carrying[:-1] & carrying[1:] & (lowest[:-1] == lowest[1:])
    steps = np.flatnonzero(same)
    if len(steps) < 3:
        return 1.0
    above = root[steps, 2] - measured.heights[steps, lowest[steps]]
    height = float(np.median(above) / np.median(root[steps, 2]))
    way = np.diff(root[:, :2], axis=0)[steps]
    travel, slip = _proportion(way, way - measured.slides[steps, lowest[steps]])
    gone = float(np.linalg.norm(way, axis=1).sum())
    if gone > _TRAVEL and slip < _SLIP and abs(travel / height - 1.0) < AGREE:
        scale = math.sqrt(travel * height)
    elif gone > _FAR and slip < _SLIP and abs(travel - 1.0) > LEGS_MAJOR:
        scale = travel
    elif np.ptp(np.quantile(root[steps, 2], [0.02, 0.98])) > _CROUCH:
        slope, floor = np.polyfit(root[steps, 2], above, 1)
        bowed = np.std(above - slope * root[steps, 2] - floor)
        scale = height if max(abs(floor), bowed) < _LEVEL else 1.0
    else:
        return 1.0
    return scale if abs(scale - 1.0) > LEGS and 1.0 / LARGEST < scale < LARGEST else 1.0


def _proportion(way: np.ndarray, pushed: np.ndarray) -> tuple[float, float]:
    """s of pushed ≈ s · way, both (K, 2), without the quarter that fits worst; and the share of what is
    pushed that it leaves."""
    keep = np.ones(len(way), dtype=bool)
    scale, left = 1.0, np.zeros(len(way))
    for _ in range(5):
        scale = float((way[keep] * pushed[keep]).sum() / max((way[keep] ** 2).sum(), 1e-12))
        left = np.linalg.norm(pushed - scale * way, axis=1)
        keep = left <= np.quantile(left, 0.75)
    return scale, float(left[keep].sum() / max(np.linalg.norm(pushed[keep], axis=1).sum(), 1e-12))


def check_proportions(clip: Clip, scale: float) -> Iterator[Finding]:
    """The finding that the character's legs are `scale` times as long as those of `clip`."""
    if scale != 1.0:
        yield Places(clip).finding(
            "proportions",
            severity(abs(scale - 1.0), LEGS_MAJOR),
            f"the body's legs are {100 * abs(scale - 1.0):.0f} % "
            f"{'longer' if scale > 1.0 else 'shorter'} than the clip's (scale {scale:.2f}); the other "
            "findings are of the clip at that scale",
            None,
            scale,
            "times",
            "--fix OUT scales travel and height, and the time by the scale's root.",
        )


def scaled(clip: Clip, scale: float) -> Clip:
    """`clip` for legs `scale` times as long: travel and height, and time by its root."""
    position = clip.root_position * scale
    position[:, :2] += (1.0 - scale) * clip.root_position[0, :2]
    return replace(clip, times=clip.times * math.sqrt(scale), root_position=position)
