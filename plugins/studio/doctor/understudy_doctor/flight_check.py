"""Stretches of a clip from which no controller can go on as it does, since they do not obey gravity."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from understudy_characters.letting_go import ASTRAY, TURNED, LettingGo
from understudy_doctor.findings import Finding, Places, Severity, intervals
from understudy_doctor.measurements import CONTACT_HEIGHT, Measurements

FLOATING = 0.75
"""Share of a flight's frames in which the body hardly falls: then it floats, which is another finding."""
SHORTEST = 0.1
"""s: in a shorter flight nothing gets far; a runner's take about that."""


def check_flights(measured: Measurements, gone: LettingGo) -> Iterator[Finding]:
    """A finding for each stretch of starts that land beside the clip, but where it floats."""
    high = measured.heights.min(1) - measured.ground > CONTACT_HEIGHT
    least = max(2, round(SHORTEST / measured.dt))
    flies, floats = np.zeros((2, len(high)), dtype=bool)
    for first, last in intervals(high, least=least):
        during = slice(first, last + 1)
        held = measured.supported[during].mean() > FLOATING
        (floats if held else flies)[during] = True
    if not flies.any():
        return
    frames = np.round(gone.times / measured.dt).astype(int).clip(0, len(high) - 1)
    places, bad = Places(measured.clip), gone.bad & ~floats[frames]
    for first, last in intervals(bad, close=1):
        here = slice(first, last + 1)
        worst, turn = float(gone.away[here].max()), float(gone.turned[here].max())
        yield places.finding(
            "flight", Severity.MINOR,
            f"{bad[here].sum()} of {len(bad)} starts: a body that begins here in the clip's own state lands up to "
            f"{worst:.2f} m and {turn:.1f} rad beside it, whatever the muscles do",
            (int(frames[first]), int(frames[last])), max(worst / ASTRAY, turn / TURNED), "bounds",
            "--fix OUT puts flights on parabolas; or let no episode begin here.",
        )  # fmt: skip
