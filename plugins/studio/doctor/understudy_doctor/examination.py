"""An examination: everything the doctor finds out about one clip."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.letting_go import LOW, LettingGo, landed, let_go
from understudy_doctor.character_checks import check_mapping, check_on_character, missing_joints
from understudy_doctor.clip_checks import check_clip, closes
from understudy_doctor.clip_repairs import undamaged
from understudy_doctor.findings import Finding, Severity
from understudy_doctor.flight_check import check_flights
from understudy_doctor.measurements import Measurements
from understudy_doctor.proportions import check_proportions, leg_scale, scaled
from understudy_motion.clip import Clip
from understudy_motion.section import Floor

__all__ = ["foot_contacts"]

NEEDS_CHARACTER = (
    "ground, feet, joint limits, torques: the clip's joints are those of no known character "
    "(give one with --character, or retarget the clip)"
)
NORMALISED = "lengths of the file's quaternions: reading normalises them"
UNMENDED = "No repair here makes it better; cut it, or capture or retarget it anew."
OPEN_LOOP = "what happens across the seam, because the loop does not close"


@dataclass(frozen=True)
class Examination:
    """The findings, in order of time within their severity, and what they were found from."""

    clip: Clip
    character: Character | None
    measured: Measurements | None
    findings: tuple[Finding, ...]
    skipped: tuple[str, ...]
    scale: float = 1.0  #: of the clip, for the character's legs, at which it was measured
    gone: LettingGo | None = None  #: what becomes of bodies that are let go in its states
    floor: Floor = "lowest"  #: how training is to put it on the floor
    level: float | None = None  #: m above z = 0 of the floor it stands on, where that is known

    @property
    def worst(self) -> Severity | None:
        """The greatest severity among the findings."""
        found = {finding.severity for finding in self.findings}
        return next((s for s in (Severity.MAJOR, Severity.MINOR) if s in found), None)


def final(examined: Examination) -> Examination:
    """The examination of a repaired clip: what it still has, no repair makes better."""
    findings = (
        replace(f, remedy=UNMENDED) if f.remedy.startswith("--fix") else f
        for f in examined.findings
    )
    return replace(examined, findings=tuple(findings))


def examine(
    clip: Clip,
    character: Character | None,
    floor: Floor = "lowest",
    level: float | None = None,
) -> Examination:
    """Examine `clip`, on `character` if there is one; training is to put it on the floor by `floor`
    (``motion.floor``). `level`: m above z = 0 of the floor it stands on, where that is known."""
    found = list(check_clip(clip))
    skipped, measured, scale, gone = [NORMALISED], None, 1.0, None
    if character is None:
        skipped.append(NEEDS_CHARACTER)
    else:
        found += check_mapping(clip, character)
        if missing_joints(clip, character):
            skipped.append("ground, feet, joint limits, torques: joints are missing")
        else:
            if clip.loop and not closes(clip):
                skipped.append(OPEN_LOOP)
            measured, scale = measure(clip, character, level)
            found += [*check_proportions(clip, scale), *check_on_character(clip, measured)]
            asked = clip if scale == 1.0 else measured.clip
            aloft = float(np.ptp(measured.heights.min(1))) > LOW
            gone = let_go(asked, character, floor) if aloft else landed(asked)
            found += check_flights(measured, gone)
    found.sort(key=lambda f: (f.severity != Severity.MAJOR, f.start, f.kind, f.joints))
    return Examination(
        clip, character, measured, tuple(found), tuple(skipped), scale, gone, floor, level
    )


def measure(
    clip: Clip, character: Character, level: float | None = None
) -> tuple[Measurements, float]:
    """What can be measured of `clip`, its damage interpolated over, on a character that has its joints;
    scaled to the character's legs, and by how much. `level`: as of :func:`examine`."""
    moving = undamaged(clip)
    if clip.loop and not closes(clip):
        moving = replace(moving, loop=False)
    measured = Measurements(moving, character, level=level)
    scale = leg_scale(measured)
    if scale != 1.0:
        measured = Measurements(scaled(moving, scale), character, math.sqrt(scale), level)
    return measured, scale


def foot_contacts(clip: Clip, character: Character, times: Tensor) -> tuple[np.ndarray, float]:
    """When the character's feet touch the ground in `clip`, (F, feet) bool at `times` (F,) s, and the
    height of that ground, m. A looping clip goes on, another one holds its ends."""
    measured, scale = measure(clip, character)
    within = times % clip.duration if clip.loop else times.clamp(0.0, clip.duration)
    if clip.loop:  # its last frame is of this cycle
        within = torch.where((times > 0.0) & (within == 0.0), clip.duration, within)
    nearest = np.abs(measured.times - within[:, None].numpy()).argmin(1)
    return measured.touching[nearest][:, list(measured.feet)], measured.ground / scale
