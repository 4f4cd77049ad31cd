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
from scipy.interpolate import BPoly, PchipInterpolator
from scipy.spatial.transform import Rotation

from understudy.errors import ConfigError
from understudy_humanoid.clips import figure
from understudy_humanoid.clips.curves import spline
from understudy_humanoid.clips.limbs import (
    REACH,
    SHIN,
    THIGH,
    arm,
    leg,
    leg_to,
    rolled,
    room,
    socket,
)
from understudy_motion.clip import Clip

TOE_OFF = 0.60  #: phase at which a foot leaves the floor
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
#: Phases of swing, and how far above the floor the foot's lower end then is, m.
_CLEARANCE = np.array([(0.67, 0.026), (0.80, 0.026), (0.91, 0.024)])
#: Seconds by which the head looks ahead on an arc, and height over which the body leans into it, m.
_LOOK_AHEAD, _LEANING_HEIGHT = 0.3, 0.85


@figure.remembered
def generated_walk(
    *,
    #: m/s, along the path, up to 3
    speed: float = 1.2,
    #: seconds per two steps, from 0.4 to 3; ``speed * cycle`` is the stride length
    cycle: float = 1.05,
    #: rad/s, to the left positive, up to 1 either way; the path is an arc of radius ``speed /
    #: heading_rate``, at least 0.5 m, into which the body leans
    heading_rate: float = 0.0,
    #: frames/s, rounded so that a step is a whole number of frames
    frame_rate: float = 60.0,
) -> Clip:
    """One gait cycle, two steps, of a level walk from a right heel strike, along +x or an arc.

    Parameters
    ----------
    speed
        m/s, along the path, up to 3.
    cycle
        seconds per two steps, from 0.4 to 3; ``speed * cycle`` is the stride length.
    heading_rate
        rad/s, to the left positive, up to 1 either way. The path is an arc of radius
        ``speed / heading_rate``, at least 0.5 m; the body leans into it.
    frame_rate
        frames/s, rounded so that a step is a whole number of frames.

    The defaults are an adult's at an easy pace: 114 steps/min and a stride of 1.26 m. Perry's norms
    are 113 steps/min and 1.41 m; the stride here is shortened with the leg, from about 0.93 m to
    the character's 0.83 m, at the same cadence.

    Returns a looping clip; of a straight walk the second half mirrors the first.

    Raises
    ------
    ConfigError
        a parameter is outside its range, the arc is too tight, or the stride is too
        long for the legs.
    """
    figure.check("walk", 0.05, 3.0, speed=speed)
    figure.check("walk", 0.4, 3.0, cycle=cycle)
    figure.check("walk", -1.0, 1.0, heading_rate=heading_rate)
    if abs(heading_rate) > 2.0 * speed:
        raise ConfigError(
            f"walk: heading_rate={heading_rate:g} is not possible at speed={speed:g}: the arc's "
            "radius would be below 0.5 m."
        )
    motion = figure.grid("walk", cycle, frame_rate, multiple=2)
    phase = motion.times / cycle
    stride = speed * cycle
    wave = 2.0 * np.pi * phase
    lean = heading_rate * speed / figure.GRAVITY

    obliquity = -3.5 * np.sin(wave - 0.3) - np.degrees(lean)
    upright = figure.turns(5.0 * np.cos(wave), 3.0, obliquity)
    joints = _upper_body(wave, upright, lean, heading_rate * _LOOK_AHEAD)
    sway = -0.02 * np.sin(wave - 0.3) + _LEANING_HEIGHT * lean
    curvature = heading_rate / speed
    place, heading = _along_arc(stride * phase, sway, curvature)
    pelvis = figure.product(figure.turns(np.degrees(heading), 0.0, 0.0), upright)
    root = np.column_stack([place, -0.022 * np.cos(2.0 * wave - 0.8)])
    feet: dict[figure.Side, tuple[figure.Array, Rotation]] = {
        "right": _foot("right", phase, stride, 0.235 * stride, curvature),
        "left": _foot("left", phase + 0.5, stride, -0.265 * stride, curvature),
    }
    gaps = [ankle - socket(side, root, pelvis) for side, (ankle, _) in feet.items()]
    farthest = max(np.linalg.norm(gap[:, :2], axis=1).max() for gap in gaps)
    if farthest > 0.7 * (THIGH + SHIN):
        raise ConfigError(
            f"walk: speed={speed:g} with cycle={cycle:g} is not possible: the stride of "
            f"{stride:.2f} m is too long for the legs; shorten the cycle."
        )
    root[:, 2] += min(room(gap, REACH) for gap in gaps)

    joints["root"] = pelvis
    for side, (ankle, foot) in feet.items():
        joints |= leg(side, leg_to(side, root, pelvis, ankle, foot))
    return figure.make_clip("walk", motion, root, joints, loop=True)


def _along_arc(
    distance: figure.Array, aside: figure.Array | float, curvature: float
) -> tuple[figure.Array, figure.Array]:
    """Where one is, (F, 2) m, and one's heading, (F,) rad, `distance` (F,) m along an arc from the
    origin and `aside` m to its left."""
    heading = curvature * distance
    chord = distance * np.sinc(0.5 * heading / np.pi)
    x = chord * np.cos(0.5 * heading) - aside * np.sin(heading)
    y = chord * np.sin(0.5 * heading) + aside * np.cos(heading)
    return np.stack([x, y], axis=1), heading


def _foot(
    side: figure.Side, phase: figure.Array, stride: float, strike: float, curvature: float
) -> tuple[figure.Array, Rotation]:
    """One foot's path in the world.

    Parameters
    ----------
    side
        whose foot.
    phase
        (F,) of that side, any number of cycles.
    stride
        m.
    strike
        how far along the path, in m, the foot of phase 0 to ``TOE_OFF`` lies flat.
    curvature
        of the path, 1/m.

    Returns
    -------
    tuple[figure.Array, Rotation]
        Ankle positions (F, 3) and foot rotations (F,).
    """
    within, steps = phase % 1.0, np.floor(phase)
    roll = np.where(
        (within <= TOE_OFF)[:, None], _rolling(np.minimum(within, TOE_OFF)), _swinging(within)
    )
    swing = np.clip((within - TOE_OFF) / (1.0 - TOE_OFF), 0.0, 1.0)
    travel = strike + stride * (steps + swing**2 * (3.0 - 2.0 * swing))
    place, heading = _along_arc(travel, figure.SIGN[side] * STEP_HALF_WIDTH, curvature)
    yaw = heading + figure.SIGN[side] * TOE_OUT
    ahead = np.stack([np.cos(yaw), np.sin(yaw)], axis=1)
    ankle = np.column_stack([place + roll[:, :1] * ahead, roll[:, 1]])
    return ankle, figure.turns(np.degrees(yaw), _pitch(within), 0.0)


def _pitch(phase: figure.Array) -> figure.Array:
    """Foot pitch in degrees at phases (F,) near [0, 1], smooth and periodic."""
    phases = np.concatenate([_PITCH[:, 0] + cycle for cycle in (-1.0, 0.0, 1.0)])
    return PchipInterpolator(phases, np.tile(_PITCH[:, 1], 3))(phase)


def _rolling(phase: figure.Array) -> figure.Array:
    """Ankle (F, 2) m in stance, as :func:`rolled`."""
    return rolled(np.radians(_pitch(phase)))


def _swinging(phase: figure.Array) -> figure.Array:
    """Ankle (F, 2) m in swing, as in :func:`_rolling`, meeting stance with its velocity."""
    step = 1e-4
    ends = np.array([TOE_OFF, 1.0])
    place = _rolling(ends)
    speed = (_rolling(ends + step) - _rolling(ends - step)) / (2.0 * step)
    phases, clearance = _CLEARANCE.T
    keys = np.column_stack([[TOE_OFF, *phases, 1.0], np.zeros(len(phases) + 2)])
    keys[1:-1, 1] = _rolling(phases)[:, 1] + clearance
    keys[[0, -1], 1] = place[:, 1]
    height = spline(keys, speed[:1, 1], speed[1:, 1])(phase)[:, 0]
    along = BPoly.from_derivatives(ends, np.stack([place[:, 0], speed[:, 0]], axis=1))(phase)
    return np.stack([along, height], axis=1)


def _upper_body(wave: figure.Array, pelvis: Rotation, lean: float, look: float) -> figure.Pose:
    """Chest against the pelvis, a level head that looks ahead, arms against the legs.

    On an arc the trunk leans by `lean` rad and the head turns by `look` rad into it.
    """
    thorax = figure.turns(
        -4.0 * np.cos(wave - 0.2), 4.0, 0.8 * np.sin(wave - 0.3) - np.degrees(lean)
    )
    head = figure.turns(np.degrees(look) + 0.0 * wave, 2.0, 0.0)
    joints = figure.trunk(pelvis, thorax, head)
    for side in figure.SIDES:
        sign = figure.SIGN[side]
        forward = sign * np.cos(wave - 0.25)
        upper = figure.turns(-sign * 3.0, 2.0 - 20.0 * forward, sign * 7.0)
        elbow = np.radians(24.0 + 12.0 * np.cos(wave - 0.55) * sign)
        joints |= arm(side, np.column_stack([upper.as_rotvec(), elbow]))
    return joints
