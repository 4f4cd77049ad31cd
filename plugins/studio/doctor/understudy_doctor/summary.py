"""An examination as text and as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np

from understudy_characters.letting_go import LettingGo
from understudy_doctor.examination import Examination
from understudy_doctor.findings import Finding, Severity, intervals

Row = dict[str, Any]
PARTS = 10
"""Of the clip: starts are told of by tenths."""


def heading(examined: Examination) -> str:
    """The clip in one line."""
    clip = examined.clip
    kind = "loops" if clip.loop else "does not loop"
    on = f"; on the {examined.character.name}" if examined.character else ""
    return (
        f"{clip.name}: {clip.duration:.2f} s, {clip.num_frames} frames at {clip.frame_rate:.4g} "
        f"frames/s, {kind}{on}"
    )


def verdict(findings: Sequence[Finding]) -> str:
    """How many findings there are."""
    if not findings:
        return "No findings."
    counts = [
        f"{sum(f.severity == level for f in findings)} {level}" for level in reversed(Severity)
    ]
    return f"{' and '.join(counts)} findings."


def text(examined: Examination) -> str:
    """Heading, findings, contacts, what was not checked, and the verdict, each in a line."""
    lines = [heading(examined), *(finding.line() for finding in examined.findings)]
    for joint, spans in contacts(examined).items():
        when = ", ".join(f"{a:.2f}–{b:.2f}" for a, b in spans)
        lines.append(f"contact: {joint} {f'{when} s' if when else 'never'}")
    if examined.gone is not None:
        lines.append(f"let go in the clip's own state: {let_go_words(examined.gone)}")
    lines += [f"not checked: {what}" for what in examined.skipped]
    return "\n".join([*lines, verdict(examined.findings)])


def as_json(examined: Examination) -> Row:
    """Everything that was found, under keys that stay; the README lists them."""
    clip = examined.clip
    return {
        "clip": clip.name,
        "source": clip.source,
        "licence": clip.licence,
        "seconds": _rounded(clip.duration),
        "frames": clip.num_frames,
        "frame_rate": _rounded(clip.frame_rate),
        "loop": clip.loop,
        "character": examined.character.name if examined.character else None,
        "verdict": str(examined.worst) if examined.worst else "none",
        "findings": findings_as_json(examined.findings),
        "ground": _rounded(examined.measured.ground) if examined.measured else None,
        "contacts": {joint: [*map(list, spans)] for joint, spans in contacts(examined).items()},
        "torque": torques(examined),
        "let_go": None if examined.gone is None else _let_go(examined.gone),
        "skipped": list(examined.skipped),
    }


def let_go_words(gone: LettingGo) -> str:
    """What becomes of bodies that are let go in the clip's states, in a line."""
    share = (
        f"{100 * gone.share:.1f} % of {len(gone.times)} starts land outside of the spacetime bounds"
    )
    if not gone.bad.any():
        return share
    tenths = ", ".join(f"{100 * part:.0f}" for part in gone.by_phase(PARTS))
    return f"{share}; by tenths of the clip: {tenths} %"


def _let_go(gone: LettingGo) -> Row:
    return {
        "starts": len(gone.times),
        "bad": _rounded(gone.share),
        "by_phase": [_rounded(part) for part in gone.by_phase(PARTS)],
    }


def findings_as_json(findings: Iterable[Finding]) -> list[Row]:
    """One object per finding."""
    return [
        {
            "kind": f.kind,
            "severity": str(f.severity),
            "what": f.what,
            "frames": [f.first, f.last],
            "seconds": [_rounded(f.start), _rounded(f.stop)],
            "joints": list(f.joints),
            "value": _rounded(f.value),
            "unit": f.unit,
            "remedy": f.remedy,
        }
        for f in findings
    ]


def contacts(examined: Examination) -> dict[str, list[tuple[float, float]]]:
    """By joint that touches the ground: from when to when, s."""
    measured = examined.measured
    if measured is None:
        return {}
    result = {}
    for row, name in enumerate(measured.character.joint_names):
        spans = intervals(measured.touching[:, row])
        if spans or row in measured.feet:
            ends = measured.times
            result[name] = [(_rounded(ends[a]), _rounded(ends[b])) for a, b in spans]
    return result


def torques(examined: Examination) -> dict[str, Row]:
    """By joint: the peak torque, N m, and its share of the limit, null where there is none."""
    measured = examined.measured
    if measured is None:
        return {}
    support = measured.support
    result = {}
    for row, name in list(enumerate(measured.character.joint_names))[1:]:
        share = support.share[:, row]
        known = bool(np.isfinite(share).all())
        result[name] = {
            "peak": _rounded(support.torque[:, row].max()),
            "share": _rounded(share.max()) if known else None,
        }
    return result


def comparison(before: Sequence[Finding], after: Sequence[Finding]) -> dict[str, tuple[str, str]]:
    """By kind: what there was before a repair and after it."""
    kinds = sorted({f.kind for f in (*before, *after)})
    return {kind: (_count(before, kind), _count(after, kind)) for kind in kinds}


def _count(findings: Sequence[Finding], kind: str) -> str:
    own = [f for f in findings if f.kind == kind]
    if not own:
        return "none"
    worst = max(own, key=lambda f: abs(f.value))
    return f"{len(own)}, at worst {abs(worst.value):.2g} {worst.unit}".rstrip()


def _rounded(value: float) -> float:
    return round(float(value), 4)
