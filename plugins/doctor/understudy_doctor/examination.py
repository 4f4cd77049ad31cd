"""An examination: everything the doctor finds out about one clip."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

from understudy_characters.character import Character
from understudy_doctor.character_checks import (
    check_mapping,
    check_on_character,
    missing_joints,
)
from understudy_doctor.clip_checks import check_clip, closes
from understudy_doctor.clip_repairs import undamaged
from understudy_doctor.findings import Finding, Severity
from understudy_doctor.measurements import Measurements
from understudy_doctor.proportions import check_proportions, leg_scale, scaled
from understudy_motion.clip import Clip

NEEDS_CHARACTER = (
    "ground, feet, joint limits, torques: the clip's joints are those of no known character "
    "(give one with --character, or retarget the clip)"
)
NORMALISED = "lengths of the file's quaternions: reading normalises them"
OPEN_LOOP = "what happens across the seam, because the loop does not close"


@dataclass(frozen=True)
class Examination:
    """The findings, in order of time within their severity, and what they were found from."""

    clip: Clip
    character: Character | None
    measured: Measurements | None
    findings: tuple[Finding, ...]
    skipped: tuple[str, ...]

    @property
    def worst(self) -> Severity | None:
        """The greatest severity among the findings."""
        found = {finding.severity for finding in self.findings}
        return next((s for s in (Severity.MAJOR, Severity.MINOR) if s in found), None)


def examine(clip: Clip, character: Character | None) -> Examination:
    """Examine `clip`, on `character` if there is one."""
    found = list(check_clip(clip))
    skipped, measured = [NORMALISED], None
    if character is None:
        skipped.append(NEEDS_CHARACTER)
    else:
        found += check_mapping(clip, character)
        if missing_joints(clip, character):
            skipped.append("ground, feet, joint limits, torques: joints are missing")
        else:
            moving = undamaged(clip)
            if clip.loop and not closes(clip):
                moving = replace(moving, loop=False)
                skipped.append(OPEN_LOOP)
            measured = Measurements(moving, character)
            if (scale := leg_scale(measured)) != 1.0:
                found += check_proportions(clip, scale)
                measured = Measurements(scaled(moving, scale), character, math.sqrt(scale))
            found += check_on_character(clip, measured)
    found.sort(key=lambda f: (f.severity != Severity.MAJOR, f.start, f.kind, f.joints))
    return Examination(clip, character, measured, tuple(found), tuple(skipped))
