"""A walk of our own, for the character of :mod:`understudy_humanoid.character`.

The feet are laid down first and the legs follow. Through its stance a foot rolls over its heel,
lies flat, and rolls over its toe, always about a line that stays where it is on the floor, so
nothing slides; in swing a smooth curve takes the ankle to the next heel strike. The pelvis moves
with the small bob, sway, turn and list of human walking, just low enough for the legs to reach the
feet, and analytic inverse kinematics finds hips, knees and ankles. Arms swing against the legs.

Phases are fractions of a gait cycle from the same side's heel strike. The profiles are drawn by hand
after the common description of normal gait (Perry, "Gait Analysis", 1992: stance to 0.60, pelvic
rotation about 5 deg, obliquity 3 to 4 deg); they are no recording of anybody.
"""

from __future__ import annotations

import numpy as np
import torch
from numpy.typing import NDArray
from scipy.interpolate import BPoly, PchipInterpolator
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError
from understudy_humanoid.character import BODIES
from understudy_motion.clip import Clip, Skeleton

Array = NDArray[np.float64]

TOE_OFF = 0.60  #: phase at which a foot leaves the floor
REACH = 0.99  #: longest distance from hip to ankle, as a part of the straight leg
STEP_HALF_WIDTH = 0.07  #: m, of the ankles from the line of travel
TOE_OUT = np.radians(6.0)

#: Foot pitch in degrees, toe down positive, at phases: heel strike, flat, heel off, swing.
_PITCH = np.array(
    [
        (0.00, -17.0),
        (0.09, 0.0),
        (0.34, 0.0),
        (0.48, 17.0),
        (TOE_OFF, 50.0),
        (0.66, 57.0),
        (0.76, 36.0),
        (0.87, -2.0),
        (0.95, -16.0),
    ]
)
#: Phase of mid swing and how far above its flat stance the ankle then is, m.
_MID_SWING = (0.78, 0.085)

_ROWS = {row.name: row for row in BODIES}
_THIGH = -_ROWS["right_knee"].offset[2]
_SHIN = -_ROWS["right_ankle"].offset[2]
_FOOT = _ROWS["right_ankle"]
_SOLE = _FOOT.centre[2] - _FOOT.size[2]
_HEEL, _TOE = _FOOT.centre[0] - _FOOT.size[0], _FOOT.centre[0] + _FOOT.size[0]


def generated_walk(*, speed: float = 1.2, cycle: float = 1.05, frame_rate: float = 60.0) -> Clip:
    """One gait cycle, two steps, of a level walk along +x, from a right heel strike.

    Args:
        speed: m/s.
        cycle: seconds per two steps; ``speed * cycle`` is the stride length.
        frame_rate: frames/s, rounded so that a step is a whole number of frames.

    The defaults are an adult's at an easy pace: 114 steps/min and a stride of 1.26 m. Perry's norms
    are 113 steps/min and 1.41 m; the stride here is shortened with the leg, from about 0.93 m to
    the character's 0.83 m, at the same cadence.

    Returns:
        A looping clip whose second half mirrors its first.

    Raises:
        ConfigError: a number is not positive, or the stride is too long for the legs.
    """
    if not all(0.0 < value < np.inf for value in (speed, cycle, frame_rate)):
        raise ConfigError("generated_walk: speed, cycle and frame_rate must be above 0 and finite.")
    phase = np.linspace(0.0, 1.0, 2 * max(8, round(0.5 * cycle * frame_rate)) + 1)
    stride = speed * cycle
    wave = 2.0 * np.pi * phase

    pelvis = _turns(5.0 * np.cos(wave), 3.0, -3.5 * np.sin(wave - 0.3))
    bob = -0.022 * np.cos(2.0 * wave - 0.8)
    root = np.stack([stride * phase, -0.02 * np.sin(wave - 0.3), bob], axis=1)
    feet = {
        "right": _foot(phase, stride, -1.0, strike=0.235 * stride),
        "left": _foot(phase + 0.5, stride, 1.0, strike=-0.265 * stride),
    }
    sockets = {side: pelvis.apply(_ROWS[f"{side}_hip"].offset) for side in feet}
    root[:, 2] += min(_highest(root + sockets[side], ankle) for side, (ankle, _) in feet.items())

    joints = {"root": pelvis, **_upper_body(wave, pelvis)}
    for side, (ankle, foot) in feet.items():
        thigh, knee = _two_links(ankle - root - sockets[side], pelvis)
        joints[f"{side}_hip"] = pelvis.inv() * thigh
        joints[f"{side}_knee"] = knee
        joints[f"{side}_ankle"] = (thigh * knee).inv() * foot
    return _clip(cycle * phase, root, joints)


def _turns(yaw: Array | float, pitch: Array | float, roll: Array | float) -> Rotation:
    """Turns about z, then the turned y, then the turned x; degrees, (F,)."""
    return Rotation.from_euler("ZYX", np.stack(np.broadcast_arrays(yaw, pitch, roll), 1), True)


def _about_y(angle: Array) -> Rotation:
    """Turns about y by (F,) rad."""
    return Rotation.from_rotvec(angle[:, None] * [0.0, 1.0, 0.0])


def _foot(phase: Array, stride: float, side: float, strike: float) -> tuple[Array, Rotation]:
    """One foot's path in the world.

    Args:
        phase: (F,) of that side, any number of cycles.
        stride: m.
        side: 1 for left, -1 for right.
        strike: x in m at which the foot of phase 0 to ``TOE_OFF`` lies flat.

    Returns:
        Ankle positions (F, 3) and foot rotations (F,).
    """
    within, steps = phase % 1.0, np.floor(phase)
    roll = np.where(
        (within <= TOE_OFF)[:, None], _rolling(np.minimum(within, TOE_OFF)), _swinging(within)
    )
    swing = np.clip((within - TOE_OFF) / (1.0 - TOE_OFF), 0.0, 1.0)
    travel = stride * (steps + swing**2 * (3.0 - 2.0 * swing))
    yaw = side * TOE_OUT
    x = strike + travel + np.cos(yaw) * roll[:, 0]
    y = side * STEP_HALF_WIDTH + np.sin(yaw) * roll[:, 0]
    return np.stack([x, y, roll[:, 1]], 1), _turns(np.degrees(yaw), _pitch(within), 0.0)


def _pitch(phase: Array) -> Array:
    """Foot pitch in degrees at phases (F,) near [0, 1], smooth and periodic."""
    phases = np.concatenate([_PITCH[:, 0] + cycle for cycle in (-1.0, 0.0, 1.0)])
    return PchipInterpolator(phases, np.tile(_PITCH[:, 1], 3))(phase)


def _rolling(phase: Array) -> Array:
    """Ankle (F, 2) m in stance: along the foot, from its place over the flat foot, and height."""
    pitch = np.radians(_pitch(phase))
    pivot = np.where(pitch < 0.0, _HEEL, _TOE)
    along = pivot - pivot * np.cos(pitch) - _SOLE * np.sin(pitch)
    return np.stack([along, pivot * np.sin(pitch) - _SOLE * np.cos(pitch)], axis=1)


def _swinging(phase: Array) -> Array:
    """Ankle (F, 2) m in swing, as in :func:`_rolling`, meeting stance with its velocity."""
    step = 1e-4
    ends = np.array([TOE_OFF, 1.0])
    place = _rolling(ends)
    speed = (_rolling(ends + step) - _rolling(ends - step)) / (2.0 * step)
    along, height = (
        [[p, v] for p, v in zip(place[:, i], speed[:, i], strict=True)] for i in (0, 1)
    )
    middle, lift = _MID_SWING
    curves = (
        BPoly.from_derivatives(ends, along),
        BPoly.from_derivatives([TOE_OFF, middle, 1.0], [height[0], [lift - _SOLE], height[1]]),
    )
    return np.stack([curve(phase) for curve in curves], axis=1)


def _highest(socket: Array, ankle: Array) -> float:
    """How far a hip socket's path (F, 3) may rise until the leg is stretched to ``REACH``."""
    gap = ankle - socket
    room = (REACH * (_THIGH + _SHIN)) ** 2 - (gap[:, :2] ** 2).sum(axis=1)
    if room.min() < (0.7 * (_THIGH + _SHIN)) ** 2:
        raise ConfigError("generated_walk: the stride is too long for the legs; shorten the cycle.")
    return float((np.sqrt(room) + gap[:, 2]).min())


def _two_links(reach: Array, pelvis: Rotation) -> tuple[Rotation, Rotation]:
    """The thigh's rotation in the world and the knee's, so that the ankle is at `reach`.

    Args:
        reach: (F, 3) m from the hip to the ankle, world.
        pelvis: (F,) whose y axis the knee's axis keeps as close to as it can.
    """
    distance = np.linalg.norm(reach, axis=1)
    bend = np.arccos((distance**2 - _THIGH**2 - _SHIN**2) / (2.0 * _THIGH * _SHIN))
    # Angle of the thigh ahead of the straight line to the ankle.
    ahead = np.arctan2(_SHIN * np.sin(bend), _THIGH + _SHIN * np.cos(bend))
    z = -reach / distance[:, None]
    y = pelvis.apply([0.0, 1.0, 0.0])
    y -= (y * z).sum(axis=1, keepdims=True) * z
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    line = Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=2))
    return line * _about_y(-ahead), _about_y(bend)


def _upper_body(wave: Array, pelvis: Rotation) -> dict[str, Rotation]:
    """Chest against the pelvis, a level head that looks ahead, arms against the legs."""
    thorax = _turns(-4.0 * np.cos(wave - 0.2), 4.0, 0.8 * np.sin(wave - 0.3))
    joints = {"chest": pelvis.inv() * thorax, "neck": thorax.inv() * _turns(0.0 * wave, 2.0, 0.0)}
    for side, sign in (("right", -1.0), ("left", 1.0)):
        forward = sign * np.cos(wave - 0.25)
        joints[f"{side}_shoulder"] = _turns(-sign * 3.0, 2.0 - 20.0 * forward, sign * 7.0)
        elbow = np.radians(24.0 + 12.0 * np.cos(wave - 0.55) * sign)
        joints[f"{side}_elbow"] = _about_y(-elbow)
    return joints


def _clip(times: Array, root: Array, joints: dict[str, Rotation]) -> Clip:
    rows = [row for row in BODIES if row.name in joints]
    names = tuple(row.name for row in rows)
    parents = tuple(-1 if row.parent is None else names.index(row.parent) for row in rows)
    quaternions = [joints[name].as_quat(scalar_first=True) for name in names]
    return Clip(
        name="walk",
        times=torch.from_numpy(times),
        root_position=torch.from_numpy(root),
        rotations=torch.from_numpy(np.stack(quaternions, axis=1)),
        joint_names=names,
        loop=True,
        skeleton=Skeleton(names, parents, np.array([row.offset for row in rows])),
        source="generated",
        licence="Apache-2.0 (generated)",
    )
