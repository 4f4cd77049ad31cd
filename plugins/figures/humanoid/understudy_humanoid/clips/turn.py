"""Generated turns in place, by stepping.

The feet take turns, the one on the inside first; each steps around the middle between them. The head
leads, chest and pelvis follow. Hips turn the legs, knees stay over the feet: a figure whose ankles do
not twist can turn so as well. The centre of mass moves as an inverted pendulum on the standing foot,
and every turn begins and ends standing at ease.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np

from understudy.errors import ConfigError
from understudy_humanoid.clips import figure, standing
from understudy_humanoid.clips.curves import (
    between,
    carried,
    ease,
    inverted_pendulum,
    monotone,
    through,
)
from understudy_humanoid.clips.limbs import arm, arm_keys, leg, leg_to, planted
from understudy_motion.clip import Clip

LIFT = 0.06  #: m, of a stepping foot

_LARGEST_STEP = np.radians(60.0)
_STEP_SECONDS = (0.3, 1.5)  #: least and most
_REST = 0.3  #: s, before the first step and after the last
_SWING = (0.2, 0.84)  #: parts of a step between which its foot is off the floor
#: Pitch of a stepping foot in degrees, at fractions of its step: the heel rises before the toe.
_PITCH = ((-0.1, 0.0), (0.0, 0.0), (0.38, 24.0), (0.84, 0.0), (0.94, 0.0))
_SHARE = 0.85  #: of the support that the standing foot takes
_LIST = 2.0  #: degrees by which the pelvis drops over the stepping foot
_SINK = 0.02  #: m, by which the hips are lower between the first step and the last
_LEADS = (0.05, 0.13, 0.25)  #: s, by which pelvis, chest and head are ahead of the feet


def generated_turn_left(
    *,
    #: rad, from 0.2 to 2 pi; each foot takes one step per 60 degrees, or part of it
    angle: float = math.pi / 2,
    #: of the whole turn; a step may take 0.3 to 1.5 s
    seconds: float = 2.4,
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """A turn to the left in place, from standing to standing.

    Returns a looping clip, whose cycle turns by `angle`.

    Raises
    ------
    ConfigError
        a parameter is outside its range, or the steps would be too quick or too slow.
    """
    return _turn("turn_left", "left", angle, seconds, frame_rate)


def generated_turn_right(
    *,
    #: rad, from 0.2 to 2 pi; each foot takes one step per 60 degrees, or part of it
    angle: float = math.pi / 2,
    #: of the whole turn; a step may take 0.3 to 1.5 s
    seconds: float = 2.4,
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """A turn to the right in place; as :func:`generated_turn_left`."""
    return _turn("turn_right", "right", angle, seconds, frame_rate)


@lru_cache(maxsize=32)  # takes long, and each part of a run asks for it anew
def _turn(name: str, inside: figure.Side, angle: float, seconds: float, frame_rate: float) -> Clip:
    figure.check(name, 0.2, 2.0 * math.pi, angle=angle)
    pairs = math.ceil(angle / _LARGEST_STEP - 1e-9)
    step = (seconds - 2.0 * _REST) / (2 * pairs)
    least, most = (2.0 * (_REST + pairs * time) for time in _STEP_SECONDS)
    if not least <= seconds <= most:
        raise ConfigError(
            f"{name}: seconds={seconds:g} is not possible for the {2 * pairs} steps of "
            f"angle={angle:.3g}: it must be at least {least:.3g} and at most {most:.3g}."
        )
    motion = figure.grid(name, seconds, frame_rate)
    times, sign = motion.times, figure.SIGN[inside]
    outside: figure.Side = "left" if inside == "right" else "right"
    begins = _REST + step * np.arange(2 * pairs)
    feet: dict[figure.Side, _Foot] = {
        side: _Foot(side, times, begins[first::2], step, sign * angle)
        for first, side in enumerate((inside, outside))
    }

    weight = sign * _weight(times, begins, step)
    support = 0.5 * (1.0 + weight[:, None] * (2.0 * _SHARE - 1.0)) * feet["left"].middle
    support += 0.5 * (1.0 - weight[:, None] * (2.0 * _SHARE - 1.0)) * feet["right"].middle
    place = inverted_pendulum(support, times[1], 0.9)
    middles = begins + 0.5 * step
    progress = (np.arange(2 * pairs) + 0.5) / (2 * pairs)
    yaws = []
    for lead in _LEADS:
        keys = [(0.02, 0.0), *zip(middles - lead, progress, strict=True), (seconds - 0.1, 1.0)]
        yaws.append(np.degrees(sign * angle) * through(times, keys)[:, 0])
    pelvis = figure.turns(yaws[0], standing.PITCH, _LIST * weight)
    thorax, head = (figure.turns(yaw, standing.PITCH, 0.0) for yaw in yaws[1:])
    upper = figure.trunk(pelvis, thorax, head)
    rest = (0.0, *standing.ARM), (seconds, *standing.ARM)
    for side in figure.SIDES:
        keys = arm_keys(side, [rest[0], (0.5 * seconds, 6.0, 14.0, 26.0), rest[1]])
        upper |= arm(side, through(times, keys))

    def build(root: figure.Array) -> figure.Pose:
        pose = dict(upper)
        for side, foot in feet.items():
            reached = leg_to(side, root, pelvis, foot.ankle, foot.rotation, knee_axes=foot.around)
            pose |= leg(side, reached)
        return pose

    last = begins[-1] + step
    sunk = between(times, 0.0, _REST) - between(times, last, last + _REST)
    goal = np.column_stack([place, standing.HEIGHT - _SINK * sunk])
    root, pose = carried(goal, build, axes=(0, 1))
    return figure.make_clip(name, motion, root, pose, loop=True)


class _Foot:
    """A foot that steps around the origin."""

    def __init__(
        self,
        side: figure.Side,
        times: figure.Array,
        begins: figure.Array,
        step: float,
        angle: float,
    ) -> None:
        """Each of the steps that begin at `begins` s turns the foot by its part of `angle` rad."""
        pitch, lift, turned = np.zeros((3, len(times)))
        for begin in begins:
            within = (times - begin) / step
            pitch += np.radians(monotone(within, _PITCH))
            swing = np.clip((within - _SWING[0]) / (_SWING[1] - _SWING[0]), 0.0, 1.0)
            lift += LIFT * (4.0 * swing * (1.0 - swing)) ** 3
            turned += angle / len(begins) * ease(swing)
        #: (F,) turns of the foot, and the knee over it, about the middle between the feet.
        self.around = around = figure.turns(np.degrees(turned), 0.0, 0.0)
        stands = np.append(standing.place(side), 0.0)
        yaw = turned + figure.SIGN[side] * standing.TOE_OUT
        self.ankle, self.rotation = planted(around.apply(stands)[:, :2], yaw, pitch)
        self.ankle[:, 2] += lift
        #: (F, 2) m, where the foot bears: under its middle.
        self.middle = around.apply(stands + np.array([standing.AHEAD, 0.0, 0.0]))[:, :2]


def _weight(times: figure.Array, begins: figure.Array, step: float) -> figure.Array:
    """Which foot bears the weight: -1 the outside's, 1 the inside's, 0 both."""
    weight = -between(times, begins[0] - 0.8 * _REST, begins[0] + _SWING[0] * step)
    for number, begin in enumerate(begins[1:]):
        moving = between(times, begin - (1.0 - _SWING[1]) * step, begin + _SWING[0] * step)
        weight += (2.0 if number % 2 == 0 else -2.0) * moving
    last = begins[-1] + _SWING[1] * step
    return weight - weight[-1] * between(times, last, last + 0.8 * _REST)
