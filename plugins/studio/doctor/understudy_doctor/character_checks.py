"""Checks of a clip on a character: ground, feet, joints, and what it asks of physics."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.ndimage import maximum_filter1d

from understudy_characters.character import Character
from understudy_doctor.dynamics import CUTOFF
from understudy_doctor.findings import Finding, Places, Severity, intervals, severity
from understudy_doctor.measurements import CONTACT_SPEED, GROUND, Contact, Measurements
from understudy_doctor.ranges import beyond, range_of
from understudy_motion.clip import Clip
from understudy_tensors import rotations

GROUND_MAJOR = 0.03
"""m into the ground, or of constant height above it: a character put into such a pose is thrown out
of the floor, or falls onto it."""
FLOAT, FLOAT_MAJOR = 0.03, 0.06
"""m above the ground while something must carry the body: a foot's height in stance, twice that."""
STANDS_ON = 0.15
"""m: from here on a body that floats is taken to stand on something; the height of a step."""
LASTING = 0.1
"""s, and at least three frames: what comes out of accelerations must last as long to be believed,
since the filter tells nothing shorter. Shorter peaks of torque are soon made good."""

SKATE, SKATE_MAJOR = 0.03, 0.09
"""m that a foot slides in one contact: what its skin gives, and a foot's width."""
SKATE_SPEED = 0.03
"""m/s, on average over the contact: slower is drift of a standing foot, which nothing feels."""

HINGE, HINGE_MAJOR = 0.02, 0.2
"""rad beyond a hinge's limit: rounding, and what a limit's spring pushes back from visibly."""
OFF_AXIS, OFF_AXIS_MAJOR = 0.05, 0.3
"""rad that a clip turns a joint about axes which its hinges lack; 0.3 rad moves a foot by 12 cm."""
RANGE_MAJOR = np.radians(30.0)
"""Beyond a human joint's range and margin: not a supple person, but a joint that is wrong."""
RANGE = np.radians(2.0)

TORQUE, TORQUE_MAJOR = 1.0, 1.5
"""Share of a joint's torque limit."""
UNEXPLAINED, UNEXPLAINED_MAJOR = 0.5, 1.0
"""Weights that act on the body though nothing can push there; the filter alone leaves 0.2 or so."""


def missing_joints(clip: Clip, character: Character) -> list[str]:
    """The character's joints that the clip lacks, by name; the root may have any name."""
    return [name for name in character.joint_names[1:] if name not in clip.joint_names[1:]]


def check_mapping(clip: Clip, character: Character) -> Iterator[Finding]:
    """Whether the clip's joints are the character's."""
    places = Places(clip)
    retarget = f"`{character.retargeting(clip)}` makes it fit."
    if missing := missing_joints(clip, character):
        yield places.finding(
            "mapping", Severity.MAJOR,
            f"{len(missing)} of {len(character.joints)} joints of the {character.name} are not in the clip",
            None, float(len(missing)), "joints", retarget, missing,
        )  # fmt: skip
        return
    if extra := [name for name in clip.joint_names[1:] if name not in character.joint_names]:
        yield places.finding(
            "mapping", Severity.MINOR,
            f"{len(extra)} joints that the {character.name} does not have are ignored",
            None, float(len(extra)), "joints", retarget, extra,
        )  # fmt: skip


def check_on_character(clip: Clip, measured: Measurements) -> Iterator[Finding]:
    """All findings that need the character; `clip` has its joints and is what frames refer to."""
    check = _Checks(clip, measured)
    yield from check.ground()
    yield from check.floating()
    yield from check.skating()
    yield from check.joints()
    yield from check.torques()


class _Checks:
    def __init__(self, clip: Clip, measured: Measurements) -> None:
        self.measured = measured
        self.names = measured.character.joint_names
        self.places = Places(clip)
        times = clip.times.numpy()
        after = np.searchsorted(times, measured.times).clip(1, len(times) - 1)
        nearer = measured.times - times[after - 1] < times[after] - measured.times
        #: Of each measured frame, the nearest frame of the clip.
        self.frame = np.where(nearer, after - 1, after)

    def finding(
        self, kind: str, level: Severity, what: str, frames: tuple[int, int] | None,
        value: float, unit: str, remedy: str, joints: Sequence[int] = (),
    ) -> Finding:  # fmt: skip
        """As :meth:`Places.finding`, with measured frames and rows of joints."""
        place = None if frames is None else (int(self.frame[frames[0]]), int(self.frame[frames[1]]))
        names = [self.names[row] for row in joints]
        return self.places.finding(kind, level, what, place, value, unit, remedy, names)

    def frames_in(self, seconds: float) -> int:
        """At least one, at most all."""
        return int(np.clip(round(seconds / self.measured.dt), 1, len(self.frame)))

    # ------------------------------------------------------------------ ground

    def ground(self) -> Iterator[Finding]:
        level = self.measured.ground
        if level:
            where = "above" if level > 0 else "below"
            yield self.finding(
                "ground_offset",
                severity(abs(level), GROUND_MAJOR),
                f"the clip stands on a floor {100 * abs(level):.1f} cm {where} z = 0",
                None,
                level,
                "m",
                f"--fix OUT {'lowers' if level > 0 else 'raises'} it.",
            )
        heights = self.measured.heights - level
        for joint in range(heights.shape[1]):
            for first, last in intervals(heights[:, joint] < -GROUND, close=self.frames_in(0.1)):
                depth = -float(heights[first : last + 1, joint].min())
                yield self.finding(
                    "penetration",
                    severity(depth, GROUND_MAJOR),
                    f"goes {100 * depth:.1f} cm into the ground",
                    (first, last),
                    depth,
                    "m",
                    "--fix OUT raises the body there.",
                    [joint],
                )

    def floating(self) -> Iterator[Finding]:
        measured = self.measured
        height = measured.heights.min(1) - measured.ground
        least = max(3, self.frames_in(LASTING))
        afloat = measured.supported & (height > FLOAT)
        # What rises or sinks under the body does not carry it.
        still = np.abs(np.gradient(height)) < CONTACT_SPEED * measured.dt
        for first, last in intervals(afloat & still, close=least, least=least):
            value = float(np.median(height[first : last + 1]))
            yield self.finding(
                "float",
                severity(value, FLOAT_MAJOR),
                f"the lowest point is {100 * value:.1f} cm above the ground, though the body does not "
                "fall: it floats, or stands on something",
                (first, last),
                value,
                "m",
                "--fix OUT lowers it."
                if value < STANDS_ON
                else "Give the character what it stands on, or cut this part.",
                [int(measured.heights[first : last + 1].min(0).argmin())],
            )
        residual = measured.support.unexplained
        touching = np.any(measured.touching, axis=1)
        # The filter smears what changes when the body lands or takes off.
        landing = np.concatenate([[False], touching[1:] != touching[:-1]])
        unclear = _grown(landing, self.frames_in(0.5 / CUTOFF)) | _grown(afloat, least)
        strange = (residual > UNEXPLAINED) & ~unclear
        for first, last in intervals(strange, close=least // 2, least=least):
            value = float(np.median(residual[first : last + 1]))
            if value <= UNEXPLAINED:
                continue
            grounded = touching[first : last + 1].any()
            who = (
                "the joints in contact" if grounded else "gravity, for nothing touches the ground,"
            )
            yield self.finding(
                "unsupported",
                severity(value, UNEXPLAINED_MAJOR),
                f"{who} cannot explain how the body moves: {value:.1f} of its weight is missing",
                (first, last),
                value,
                "weights",
                "Learning must depart from it here; loosen the tolerances, or cut this part.",
            )

    # ------------------------------------------------------------------ feet

    def skating(self) -> Iterator[Finding]:
        for contact in self.measured.contacts:
            if contact.joint not in self.measured.feet:
                continue
            distance, speed = slide(self.measured, contact)
            if distance > SKATE and speed > SKATE_SPEED:
                yield self.finding(
                    "foot_skate",
                    severity(distance, SKATE_MAJOR),
                    f"slides {100 * distance:.1f} cm while it stands ({speed:.2f} m/s)",
                    (contact.first, contact.last),
                    distance,
                    "m",
                    "--fix OUT locks the foot.",
                    [contact.joint],
                )

    # ------------------------------------------------------------------ joints

    def joints(self) -> Iterator[Finding]:
        for excess in excesses(self.measured):
            least, major, what, remedy = JOINT_FINDINGS[excess.kind]
            for first, last in intervals(excess.over > least, close=self.frames_in(0.25)):
                value = float(excess.over[first : last + 1].max())
                yield self.finding(
                    excess.kind,
                    severity(value, major),
                    what.format(value),
                    (first, last),
                    value,
                    "rad",
                    remedy,
                    [excess.joint],
                )

    def torques(self) -> Iterator[Finding]:
        least = max(3, self.frames_in(LASTING))
        support = self.measured.support
        for row, share in enumerate(support.share.T):
            for first, last in intervals(share > TORQUE, least=least):
                value = float(share[first : last + 1].max())
                torque = float(support.torque[first : last + 1, row].max())
                yield self.finding(
                    "torque",
                    severity(value, TORQUE_MAJOR),
                    f"needs about {torque:.0f} N m, {value:.1f} times what it has",
                    (first, last),
                    value,
                    "of the limit",
                    "The character cannot do this; slow the motion down, or raise the limit.",
                    [row],
                )


#: By kind: from when on it is minor, and major; what to say, and what to do.
JOINT_FINDINGS: dict[str, tuple[float, float, str, str]] = {
    "joint_limit": (
        HINGE, HINGE_MAJOR,
        "goes {:.2f} rad beyond its limit", "--fix OUT holds it at the limit.",
    ),
    "joint_axis": (
        OFF_AXIS, OFF_AXIS_MAJOR,
        "turns {:.2f} rad about axes that its hinges do not have",
        "`understudy motion retarget` makes it fit.",
    ),
    "joint_range": (
        RANGE, RANGE_MAJOR,
        "turns {:.2f} rad farther than human joints do",
        "Check the capture or the retargeting.",
    ),
}  # fmt: skip


@dataclass(frozen=True)
class Excess:
    """How far a joint goes beyond what it can do, frame by frame."""

    joint: int
    kind: str
    over: np.ndarray  #: (F,) rad, at most 0 where all is well


def excesses(measured: Measurements) -> Iterator[Excess]:
    """For hinges beyond their limits and off their axes, for balls beyond human ranges."""
    qpos = measured.qpos.numpy()
    for row, joint in enumerate(measured.character.joints[1:], 1):
        rotation = measured.clip.rotations[:, measured.clip.joint_names.index(joint.name)]
        if len(joint.axes) == 0:
            if (entry := range_of(measured.character, row)) is not None:
                yield Excess(row, "joint_range", beyond(measured.character, row, rotation, entry))
            continue
        angles = qpos[:, list(joint.addresses)]
        over = np.maximum(joint.ranges[:, 0] - angles, angles - joint.ranges[:, 1]).max(1)
        yield Excess(row, "joint_limit", over)
        made = measured.figure.rotations[:, row]
        yield Excess(row, "joint_axis", rotations.angle_between(made, rotation).numpy())


def slide(measured: Measurements, contact: Contact) -> tuple[float, float]:
    """How far a joint slides in a contact, m, from where it came down, and its mean speed, m/s."""
    steps = measured.slides[contact.first : contact.last, contact.joint]
    if len(steps) == 0:
        return 0.0, 0.0
    way = np.linalg.norm(np.cumsum(steps, axis=0), axis=1)
    return float(way.max()), float(np.linalg.norm(steps, axis=1).mean() / measured.dt)


def _grown(mask: np.ndarray, frames: int) -> np.ndarray:
    """`mask` (F,) with `frames` more true ones on either side of each run."""
    return maximum_filter1d(mask.astype(np.uint8), 2 * frames + 1) > 0
