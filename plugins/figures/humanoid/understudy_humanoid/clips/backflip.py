"""A generated backflip: a tucked somersault backwards, from standing to standing.

The centre of mass comes first: it sinks, is pushed up and back, flies as gravity wants, and is caught.
In flight the body tucks and opens through a few key poses, and the trunk turns as the conservation of
angular momentum wants, the faster the smaller the body is. The feet roll over their toes at take-off
and on landing and otherwise lie flat where they are; inverse kinematics joins them to the hips.

The key poses are drawn by hand; their numbers were then adjusted so that joints move as slowly, and
forces and torques on the body are as well explained by the feet, as the motion allows.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import lru_cache

import numpy as np
from numpy.typing import ArrayLike
from scipy.integrate import cumulative_trapezoid
from scipy.interpolate import BPoly
from scipy.optimize import fixed_point

from understudy_humanoid.clips import figure, standing
from understudy_humanoid.clips.curves import carried, monotone, spline, through
from understudy_humanoid.clips.limbs import PlantedLeg, arm, arm_keys, leg_keys, on_legs, planted
from understudy_motion.clip import Clip

#: Seconds: deepest crouch, take-off, tucked, still tucked, open, landing, deepest squat, the end.
CROUCH, OFF, TUCK, HOLD, OPEN, ON, DEEP, END = 0.466, 0.814, 1.07, 1.21, 1.37, 1.451, 1.684, 2.544
_FLIGHT = ON - OFF

# Of the centre of mass, m: its height in the crouch, at take-off, at landing and in the squat; along x
# at take-off, and how much farther it gets after landing. In flight its speed along x, m/s.
_CROUCH_HEIGHT, _OFF_HEIGHT, _ON_HEIGHT, _DEEP_HEIGHT = 0.606, 0.909, 0.755, 0.457
_OFF_PLACE, _CAUGHT, _SPEED = -0.13, -0.11, -0.721

# Pitch of the pelvis in degrees, forward positive: at times before take-off, and after landing.
_PITCH_BEFORE = ((0.0, standing.PITCH), (CROUCH, 37.0), (OFF, -18.7))
_PITCH_AFTER = ((ON, -336.0), (ON + 0.14, -321.5), (DEEP, -325.0), (END, standing.PITCH - 360.0))
#: Degrees of bending forward, relative to the pelvis and to the chest, at times.
_CHEST = (
    (0.0, 0.0),
    (CROUCH, 16.0),
    (OFF, 6.4),
    (OFF + 0.064, -12.0),
    (TUCK, 34.0),
    (HOLD + 0.025, 30.0),
    (ON, 1.8),
    (DEEP, 12.0),
    (END, 0.0),
)
_NECK = (
    (0.0, 0.0),
    (CROUCH, -25.0),
    (OFF, -10.0),
    (TUCK + 0.03, 15.0),
    (ON, -10.0),
    (DEEP, -25.0),
    (END, 0.0),
)
#: As :func:`arm_keys`: thrown back, up, around the shins, forward.
_ARMS = (
    (0.0, *standing.ARM),
    (0.36, -50.0, 8.0, 10.0),
    (OFF, 138.7, 8.0, 15.0),
    (OFF + 0.076, 160.0, 8.0, 15.0),
    (TUCK, 62.0, 10.0, 50.0),
    (HOLD, 62.0, 10.0, 50.0),
    (ON, 114.6, 12.0, 30.0),
    (DEEP, 50.0, 12.0, 25.0),
    (END, *standing.ARM),
)
#: As :func:`leg_keys`, in flight.
_LEGS = (
    (TUCK - 0.026, 112.0, 0.0, 120.0, 25.0),
    (HOLD, 118.0, 0.0, 122.0, 20.0),
    (OPEN, 99.0, 0.0, 83.0, 5.0),
)
#: Pitch of the feet in degrees at times: over their toes at take-off, and from them on landing.
_FEET_BEFORE = ((0.0, 0.0), (OFF - 0.21, 0.0), (OFF - 0.088, 12.4), (OFF, 49.6))
_FEET_AFTER = ((ON, 18.3), (ON + 0.08, 0.0), (END, 0.0))
_BRAKE = 0.05  #: s, as in :func:`bridged`


def generated_backflip(
    *,
    #: return only ten poses: standing, crouch, take-off, half tucked, tucked twice, open, landing,
    #: squat, standing
    key_poses: bool = False,
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """A backflip, from standing at ease to standing at ease 0.7 m behind. It does not loop.

    Raises
    ------
    ConfigError
        a parameter is outside its range.
    """
    clip = _clip(frame_rate)
    if not key_poses:
        return clip
    half = 0.5 * (OFF + TUCK)
    return figure.only_key_poses(
        clip, [0.0, CROUCH, OFF, half, TUCK, HOLD, OPEN, ON, DEEP, clip.duration]
    )


@lru_cache(maxsize=8)  # takes long, and each part of a run asks for it anew
def _clip(frame_rate: float) -> Clip:
    motion = figure.grid("backflip", END, frame_rate)
    times = motion.times
    goal = _centre_of_mass(times)
    legs = _legs(times, stands=float(goal[-1, 0]))
    somersault = _Somersault(times, goal, _upper_body(times), legs)
    return figure.make_clip("backflip", motion, *somersault.motion())


class _Somersault:
    """The motion of a body, all of whose joints turn about y, that keeps its angular momentum in
    flight."""

    def __init__(
        self,
        times: figure.Array,
        goal: figure.Array,
        upper: figure.Pose,
        legs: Sequence[PlantedLeg],
    ) -> None:
        self.times, self.goal, self.upper, self.legs = times, goal, upper, legs
        self.root = goal  # the latest path of the root, and pitch of the pelvis
        self.pitch = np.zeros_like(times)

    def motion(self) -> tuple[figure.Array, figure.Pose]:
        """The root's path and the pose."""
        fixed_point(self._rates, np.array([-5.0, -7.0]), xtol=1e-3)
        return self._carry()

    def _carry(self) -> tuple[figure.Array, figure.Pose]:
        upper = {**self.upper, "root": figure.about_y(self.pitch)}
        return carried(self.goal, on_legs(upper, self.legs, self.times), start=self.root)

    def _rates(self, rates: figure.Array) -> figure.Array:
        """How fast the pelvis turns at take-off and landing, (2,) rad/s, if it keeps its angular
        momentum in between, and turns at `rates` as it takes off and when it has landed."""
        flying = np.flatnonzero((self.times > OFF) & (self.times < ON))
        flight = slice(flying[0] - 1, flying[-1] + 2)
        self.pitch = _pitch(self.times, rates)
        self.root, pose = self._carry()
        momentum, inertia = figure.pitching(self.times, self.root, pose)
        # Of the joints' turning alone: what the body would have if the pelvis did not turn.
        own = (momentum - inertia * np.gradient(self.pitch, self.times))[flight]
        inertia, times = inertia[flight], self.times[flight]
        unit = cumulative_trapezoid(1.0 / inertia, times, initial=0.0)
        lost = cumulative_trapezoid(own / inertia, times, initial=0.0)
        start, stop = self.pitch[flight][[0, -1]]
        kept = (stop - start + lost[-1]) / unit[-1]
        self.pitch[flight] = start + kept * unit - lost
        return ((kept - own) / inertia)[[1, -2]]


def _pitch(times: figure.Array, rates: figure.Array) -> figure.Array:
    """Pitch of the pelvis (F,) rad with `rates` (2,) rad/s at take-off and landing."""
    before, after = np.array(_PITCH_BEFORE), np.array(_PITCH_AFTER)
    still, (off, on) = np.zeros(1), np.degrees(rates)[:, None]
    curves = (
        spline(before, still, off),
        spline(np.stack([before[-1], after[0]]), off, on),
        spline(after, on, still),
    )
    return np.radians(_pieces(times, *(curve(times)[:, 0] for curve in curves)))


def _pieces(
    times: figure.Array, before: figure.Array, flight: figure.Array, after: figure.Array
) -> figure.Array:
    """Each curve (F, ...) in its own time."""
    return np.where(times <= OFF, before, np.where(times < ON, flight, after))


def _centre_of_mass(times: figure.Array) -> figure.Array:
    """(F, 3) m: quintics that meet a free flight in place, velocity and acceleration."""
    up = (_ON_HEIGHT - _OFF_HEIGHT) / _FLIGHT + 0.5 * figure.GRAVITY * _FLIGHT
    landing = _OFF_PLACE + _SPEED * _FLIGHT
    end = landing + _CAUGHT
    height = _thrown(
        times,
        -figure.GRAVITY,
        [[standing.CENTRE, 0.0, 0.0], [_CROUCH_HEIGHT, 0.0], [_OFF_HEIGHT, up, -figure.GRAVITY]],
        [
            [_ON_HEIGHT, up - figure.GRAVITY * _FLIGHT, -figure.GRAVITY],
            [_DEEP_HEIGHT, 0.0],
            [standing.CENTRE, 0.0, 0.0],
        ],
    )
    along = _thrown(
        times,
        0.0,
        [[0.0, 0.0, 0.0], [-0.02, -0.05], [_OFF_PLACE, _SPEED, 0.0]],
        [[landing, _SPEED, 0.0], [end + 0.02, -0.1], [end, 0.0, 0.0]],
    )
    return np.stack([along, np.zeros_like(times), height], axis=1)


def _thrown(
    times: figure.Array, acceleration: float, before: list[list[float]], after: list[list[float]]
) -> figure.Array:
    """A coordinate (F,) of a throw.

    Parameters
    ----------
    times
        (F,) s.
    acceleration
        in flight.
    before
        its value and derivatives at the start, in the crouch and at take-off.
    after
        the same on landing, in the squat and at the end.
    """
    place, speed, _ = before[-1]
    flown = times - OFF
    return _pieces(
        times,
        BPoly.from_derivatives([0.0, CROUCH, OFF], before)(times),
        place + speed * flown + 0.5 * acceleration * flown**2,
        BPoly.from_derivatives([ON, DEEP, END], after)(times),
    )


def _legs(times: figure.Array, stands: float) -> list[PlantedLeg]:
    """The legs, whose feet end `stands` m along x from where they began."""
    down = (times <= OFF) | (times >= ON)
    landing = times > 0.5 * (OFF + ON)
    pitch = np.where(landing, monotone(times, _FEET_AFTER), monotone(times, _FEET_BEFORE))
    moved = np.stack([np.where(landing, stands, 0.0), np.zeros_like(times)], axis=1)
    legs = []
    for side in figure.SIDES:
        yaw = figure.SIGN[side] * standing.TOE_OUT
        ankle, foot = planted(standing.place(side) + moved, yaw, np.radians(pitch))
        legs.append(PlantedLeg(side, down, ankle, foot, leg_keys(side, _LEGS), brake=_BRAKE))
    return legs


def _upper_body(times: figure.Array) -> figure.Pose:
    def bent(keys: ArrayLike) -> figure.Array:
        return through(times, keys)[:, 0]

    pose = {
        "chest": figure.turns(0.0, bent(_CHEST), 0.0),
        "neck": figure.turns(0.0, bent(_NECK), 0.0),
    }
    for side in figure.SIDES:
        pose |= arm(side, through(times, arm_keys(side, _ARMS)))
    return pose
