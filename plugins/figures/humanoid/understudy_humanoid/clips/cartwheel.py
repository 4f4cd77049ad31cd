"""A generated cartwheel, from standing to standing.

The body turns in the plane it faces out of: a foot steps aside, the hands follow one by one while the
other leg swings over, and the feet come down in the same order. Feet and hands are laid down first and
stay where they are; inverse kinematics joins them to a trunk that turns and travels through key poses.
The second half is the mirror image of the first, played backwards.

The key poses are drawn by hand; their numbers were then adjusted so that forces and torques on the
body are as well explained by hands and feet as the motion allows.
"""

from __future__ import annotations

from functools import lru_cache
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from understudy_humanoid.clips import standing
from understudy_humanoid.clips.curves import carried, monotone, through
from understudy_humanoid.clips.figure import Array, Pose, grid, make_clip, only_key_poses, turns
from understudy_humanoid.clips.limbs import (
    HAND,
    PlantedArm,
    PlantedLeg,
    arm_keys,
    leg_keys,
    mirrored_limb,
    planted,
)
from understudy_motion.clip import Clip
from understudy_motion.mirror import mirrored

# Of a cartwheel to the left. Times in s, places in m along y, which is to the left.
MIDDLE = 1.674  #: when the body is upside down
END = 2.0 * MIDDLE
ACROSS = 1.406  #: where it then is; in the end it is as far again

#: The first half of the trunk's way: time, place, height; degrees by which the pelvis is tipped to
#: the right (negative: to the left), and by which the chest bends to the right.
_TRUNK = (
    (0.0, 0.0, standing.HEIGHT, 0.0, 0.0),
    (0.392, 0.028, 0.854, 0.0, 0.0),
    (0.803, 0.230, 0.813, -17.8, -6.1),
    (1.055, 0.484, 0.735, -48.8, -11.1),
    (1.262, 0.655, 0.773, -92.7, -24.5),
    (1.436, 0.988, 0.964, -135.3, -18.4),
    (1.575, 1.290, 1.025, -164.7, -13.3),
    (MIDDLE, ACROSS, 1.030, -180.0, 0.0),
)
_NOD = ((0.0, 0.0), (0.868, 0.0), (MIDDLE, -18.0), (END - 0.868, 0.0), (END, 0.0))

#: The left foot leaves the floor, steps, leaves it again, and is back.
_LIFT, _STEP, _KICK, _BACK = 0.310, 0.818, 1.391, END - 0.905
_STEP_PLACE, _STEP_YAW = (-0.03, 0.585), np.radians(52.6)
#: Degrees: rolling over the toe before lifting and before kicking, over the inner edge when back.
_LIFT_PITCH = ((0.0, 0.0), (_LIFT - 0.10, 0.0), (_LIFT, 22.0))
_KICK_PITCH = ((_STEP, 0.0), (_KICK - 0.22, 0.0), (_KICK, 52.0))
_BACK_ROLL = ((_BACK, 34.0), (_BACK + 0.24, 0.0), (END, 0.0))
#: The left hand's time on the floor, and its place along x and y.
_HAND_DOWN, _HAND_UP, _HAND_PLACE = 1.265, 1.768, (-0.025, 1.271)

#: As :func:`leg_keys` and :func:`arm_keys`, of the left limbs.
_LEG = (
    (0.570, 22.0, 24.0, 48.0, -8.0),
    (1.674, 0.0, 58.0, 6.0, 30.0),
    (1.922, 0.0, 47.4, 5.0, 30.0),
    (2.108, 0.0, 44.0, 5.0, 20.0),
)
_ARM = (
    (0.0, *standing.ARM),
    (0.496, 0.0, 95.0, 10.0),
    (0.868, 0.0, 150.0, 8.0),
    (1.091, 0.0, 165.0, 8.0),
    (1.984, 0.0, 165.0, 8.0),
    (2.294, 0.0, 160.0, 8.0),
    (2.604, 0.0, 120.0, 10.0),
    (2.976, 0.0, 50.0, 14.0),
    (END, *standing.ARM),
)


def generated_cartwheel(
    *,
    #: where it goes; the hand of that side is the first on the floor
    side: Literal["left", "right"] = "left",
    #: return only eleven poses: standing, the step, both feet's leaving, both hands' planting,
    #: upside down, and the same backwards
    key_poses: bool = False,
    #: frames/s of the clip, from 10 to 1000
    frame_rate: float = 60.0,
) -> Clip:
    """A cartwheel to one side, facing x, from standing at ease to standing at ease 2.8 m to that side. It
    does not loop.

    Raises
    ------
    ConfigError
        a parameter is outside its range.
    """
    clip = _clip(frame_rate)
    if side == "right":
        clip = mirrored(clip)
    if not key_poses:
        return clip
    half = [0.0, _STEP, END - _BACK, _HAND_DOWN, _KICK]
    return only_key_poses(clip, [*half, MIDDLE, *(clip.duration - time for time in half[::-1])])


@lru_cache(maxsize=8)  # takes long, and each part of a run asks for it anew
def _clip(frame_rate: float) -> Clip:
    """To the left."""
    motion = grid("cartwheel", END, frame_rate)
    times = motion.times
    first = np.array(_TRUNK)
    second = first[-2::-1] * [-1, -1, 1, -1, -1] + [END, 2.0 * ACROSS, 0.0, -360.0, 0.0]
    y, z, tip, bend = through(times, np.vstack([first, second])).T
    pelvis, chest = turns(0.0, standing.PITCH, tip), turns(0.0, 0.0, bend)
    trunk = {"root": pelvis, "chest": chest, "neck": turns(0.0, through(times, _NOD)[:, 0], 0.0)}
    legs, arms = _legs(times), _arms(times)

    def build(root: Array) -> Pose:
        pose = dict(trunk)
        for each in legs:
            pose |= each.pose(times, root, pelvis)
        for each in arms:
            pose |= each.pose(times, root, pelvis, chest)
        return pose

    root, pose = carried(np.stack([np.zeros_like(y), y, z], axis=1), build, axes=(0,))
    return make_clip("cartwheel", motion, root, pose)


def _legs(times: Array) -> tuple[PlantedLeg, PlantedLeg]:
    lifted = times < 0.5 * (_LIFT + _STEP)
    kicked = times < 0.5 * (_KICK + _BACK)
    on = (times <= _LIFT) | ((times >= _STEP) & (times <= _KICK)) | (times >= _BACK)
    began = standing.place("left")
    places = [began, np.array(_STEP_PLACE), began + np.array([0.0, 2.0 * ACROSS])]
    place = np.select([lifted[:, None], kicked[:, None]], places[:2], places[2])
    yaw = np.where(~lifted & kicked, _STEP_YAW, standing.TOE_OUT)
    pitch = np.where(lifted, monotone(times, _LIFT_PITCH), monotone(times, _KICK_PITCH)) * kicked
    roll = np.where(kicked, 0.0, monotone(times, _BACK_ROLL))
    ankle, foot = planted(place, yaw, np.radians(pitch), np.radians(roll))
    keys = leg_keys("left", _LEG)
    left = PlantedLeg("left", on, ankle, foot, keys, wide=True)
    turned = Rotation.from_rotvec(foot[::-1].as_rotvec() * [-1.0, 1.0, -1.0])
    right = PlantedLeg(
        "right", on[::-1], _opposite(ankle[::-1]), turned, _backwards(keys), wide=True
    )
    return left, right


def _arms(times: Array) -> tuple[PlantedArm, PlantedArm]:
    on = (times >= _HAND_DOWN) & (times <= _HAND_UP)
    wrist, keys = np.array([*_HAND_PLACE, HAND]), arm_keys("left", _ARM)
    near = np.array([np.pi, 0.0, 0.0])
    left = PlantedArm("left", on, wrist, keys, near)
    return left, PlantedArm("right", on[::-1], _opposite(wrist), _backwards(keys), -near)


def _opposite(places: Array) -> Array:
    """Places (..., 3) m of the first half, mirrored to those of the second."""
    return places * [1.0, -1.0, 1.0] + [0.0, 2.0 * ACROSS, 0.0]


def _backwards(keys: ArrayLike) -> Array:
    """Keys (n, 1 + K) of a left limb, mirrored and backwards in time for the right one."""
    keys = np.asarray(keys)[::-1]
    return np.column_stack([END - keys[:, 0], mirrored_limb(keys[:, 1:])])
