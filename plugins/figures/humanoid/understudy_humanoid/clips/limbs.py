"""Limbs that reach for places, and feet and hands that stay where they are put.

A limb's coordinates are what curves are drawn of. Leg (F, 7): the hip's exponential map, the knee's
angle, the ankle's exponential map. Arm (F, 4): the shoulder's exponential map, the elbow's angle. In
rad; bending is positive. The mirror image of a limb has the x and z parts of its maps negated.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from understudy_humanoid.clips.curves import bridged
from understudy_humanoid.clips.figure import (
    ROWS,
    SIGN,
    Array,
    Mask,
    Pose,
    Side,
    about_y,
    product,
    turns,
)

#: Longest distance from hip to ankle, and from shoulder to wrist, as a part of the straight limb.
REACH = 0.99
THIGH, SHIN = -ROWS["left_knee"].offset[2], -ROWS["left_ankle"].offset[2]
UPPER_ARM, FOREARM = -ROWS["left_elbow"].offset[2], -ROWS["left_wrist"].offset[2]
_FOOT = ROWS["left_ankle"]
#: The sole in the foot's frame, whose origin is the ankle: height, rear and front edge, m.
SOLE = _FOOT.centre[2] - _FOOT.size[2]
HEEL, TOE = _FOOT.centre[0] - _FOOT.size[0], _FOOT.centre[0] + _FOOT.size[0]
#: Height of the wrist's centre when the hand is on the floor, m.
HAND = ROWS["left_wrist"].size[0]


def exponential_maps(rotation: Rotation, near: ArrayLike = (0.0, 0.0, 0.0)) -> Array:
    """(F, 3) rad: of the two maps of each rotation up to a whole turn, the one closer to `near`."""
    shorter = rotation.as_rotvec()
    angle = np.linalg.norm(shorter, axis=1, keepdims=True)
    longer = shorter * (1.0 - 2.0 * np.pi / np.maximum(angle, 1e-9))
    nearer = [np.linalg.norm(each - np.asarray(near), axis=1) for each in (shorter, longer)]
    return np.where((nearer[0] <= nearer[1])[:, None], shorter, longer)


def mirrored_limb(coordinates: Array) -> Array:
    """The coordinates (..., 7) or (..., 4) of the other side's limb in the mirrored pose."""
    leg_or_arm = {7: [-1, 1, -1, 1, -1, 1, -1], 4: [-1, 1, -1, 1]}
    return coordinates * leg_or_arm[coordinates.shape[-1]]


def leg_keys(side: Side, keys: ArrayLike) -> Array:
    """Keys (n, 8), a time and a leg's coordinates, from rows of a time and what the leg does.

    Rows (n, 5): s, then in degrees the hip's flexion and abduction, the knee's flexion and the
    ankle's plantar flexion.
    """
    time, flexion, abduction, knee, ankle = _columns(keys)
    zero = np.zeros_like(time)
    left = [time, abduction, -flexion, zero, knee, zero, ankle, zero]
    return np.column_stack(left) * ([1, SIGN[side], 1, SIGN[side], 1, 1, 1, 1])


def arm_keys(side: Side, keys: ArrayLike) -> Array:
    """Keys (n, 5), a time and an arm's coordinates, from rows of a time and what the arm does.

    Rows (n, 4): s, then in degrees the shoulder's flexion and abduction, and the elbow's flexion.
    """
    time, flexion, abduction, elbow = _columns(keys)
    zero = np.zeros_like(time)
    return np.column_stack([time, SIGN[side] * abduction, -flexion, zero, elbow])


def _columns(keys: ArrayLike) -> list[Array]:
    """The time and, in rad, the angles of rows of a time and angles in degrees."""
    table = np.asarray(keys, dtype=float)
    return [table[:, 0], *np.radians(table[:, 1:]).T]


def two_links(
    reach: Array, axis: Array, lengths: tuple[float, float], sense: float
) -> tuple[Rotation, Rotation]:
    """Rotations of the upper link in the frame of `reach` and of the hinge, to bring the end there.

    Parameters
    ----------
    reach
        (F, 3) m from the upper joint to the end; where it is too far the limb is straight.
    axis
        (F, 3) what the hinge's y axis keeps as close to as it can.
    lengths
        m, of both links, which hang down in the zero pose.
    sense
        1 where the hinge bends about y, -1 where it bends about -y.
    """
    upper, lower = lengths
    distance = np.linalg.norm(reach, axis=1)
    cosine = (distance**2 - upper**2 - lower**2) / (2.0 * upper * lower)
    bend = np.arccos(np.clip(cosine, -1.0, 1.0))
    # Angle of the upper link ahead of the straight line to the end.
    ahead = np.arctan2(lower * np.sin(bend), upper + lower * np.cos(bend))
    z = -reach / distance[:, None]
    y = axis - (axis * z).sum(axis=1, keepdims=True) * z
    y /= np.linalg.norm(y, axis=1, keepdims=True)
    line = Rotation.from_matrix(np.stack([np.cross(y, z), y, z], axis=2))
    return product(line, about_y(-sense * ahead)), about_y(sense * bend)


def socket(side: Side, root: Array, pelvis: Rotation) -> Array:
    """(F, 3) m: the hip's place in the world."""
    return root + pelvis.apply(ROWS[f"{side}_hip"].offset)


def shoulder(side: Side, root: Array, pelvis: Rotation, chest: Rotation) -> Array:
    """(F, 3) m: the shoulder's place in the world, `chest` being relative to the pelvis."""
    offset = ROWS["chest"].offset + chest.apply(ROWS[f"{side}_shoulder"].offset)
    return root + pelvis.apply(offset)


def leg_to(
    side: Side,
    root: Array,
    pelvis: Rotation,
    ankle: Array,
    foot: Rotation,
    *,
    wide: bool = False,
    knee_axes: Rotation | None = None,
) -> Array:
    """Coordinates (F, 7) of the leg with its ankle at `ankle` (F, 3) and `foot` in the world.

    The knee's axis is as close as it can be to the pelvis' y axis; or, if the legs are spread
    `wide`, to that axis turned with the leg in the frontal plane; or to the y axis of `knee_axes` (F,)
    in the world.
    """
    reach = pelvis.inv().apply(ankle - socket(side, root, pelvis))
    if knee_axes is None:
        axis = _hinge_axis(reach, wide)
    else:
        axis = product(pelvis.inv(), knee_axes).apply([0.0, 1.0, 0.0])
    thigh, knee = two_links(reach, axis, (THIGH, SHIN), 1.0)
    rest = product(product(product(pelvis, thigh), knee).inv(), foot)
    bend = knee.as_rotvec()[:, 1:2]
    return np.hstack([exponential_maps(thigh), bend, exponential_maps(rest)])


def arm_to(
    side: Side,
    root: Array,
    pelvis: Rotation,
    chest: Rotation,
    wrist: Array,
    *,
    near: ArrayLike = (0.0, 0.0, 0.0),
) -> Array:
    """Coordinates (F, 4) of the arm with its wrist at `wrist` (F, 3), near a shoulder's map `near`."""
    thorax = product(pelvis, chest)
    reach = thorax.inv().apply(wrist - shoulder(side, root, pelvis, chest))
    upper, elbow = two_links(reach, _hinge_axis(reach, True), (UPPER_ARM, FOREARM), -1.0)
    return np.hstack([exponential_maps(upper, near), -elbow.as_rotvec()[:, 1:2]])


def _hinge_axis(reach: Array, wide: bool) -> Array:
    """The y axis (F, 3), turned about x with a limb that reaches sideways if it is `wide`."""
    if not wide:
        return np.tile([0.0, 1.0, 0.0], (len(reach), 1))
    aside = np.arctan2(reach[:, 1], -reach[:, 2])
    return np.stack([np.zeros_like(aside), np.cos(aside), np.sin(aside)], axis=1)


def leg(side: Side, coordinates: Array) -> Pose:
    """The pose of a leg from its coordinates (F, 7)."""
    return {
        f"{side}_hip": Rotation.from_rotvec(coordinates[:, :3]),
        f"{side}_knee": about_y(coordinates[:, 3]),
        f"{side}_ankle": Rotation.from_rotvec(coordinates[:, 4:]),
    }


def arm(side: Side, coordinates: Array) -> Pose:
    """The pose of an arm from its coordinates (F, 4)."""
    return {
        f"{side}_shoulder": Rotation.from_rotvec(coordinates[:, :3]),
        f"{side}_elbow": about_y(-coordinates[:, 3]),
    }


def rolled(pitch: Array) -> Array:
    """Ankle (F, 2) m of a foot that rolls over its heel or toe by `pitch` (F,) rad, toe down positive.

    Along the foot, from the ankle's place over the flat foot, and height above the floor.
    """
    ankle, _ = planted(np.zeros(2), 0.0, pitch)
    return ankle[:, [0, 2]]


def planted(
    place: Array, yaw: ArrayLike, pitch: ArrayLike, roll: ArrayLike = 0.0
) -> tuple[Array, Rotation]:
    """Ankle (F, 3) m and rotation (F,), in the world, of a foot that stays where it is on the floor.

    Parameters
    ----------
    place
        (F, 2) or (2,) m, below the ankle when the foot lies flat.
    yaw
        (F,) or one, rad.
    pitch
        the same, toe down positive; the foot turns about its front or rear edge.
    roll
        the same, left side up positive; the foot turns about its right or left edge.
    """
    yaw, pitch, roll = np.broadcast_arrays(*np.atleast_1d(yaw, pitch, roll))
    aside = -np.sign(roll) * _FOOT.size[1]
    pivot = np.stack([np.where(pitch < 0.0, HEEL, TOE), aside, np.full_like(aside, SOLE)], axis=1)
    heading = turns(np.degrees(yaw), 0.0, 0.0)
    foot = product(heading, turns(0.0, np.degrees(pitch), np.degrees(roll)))
    level = np.zeros((len(yaw), 3))
    level[:, :2], level[:, 2] = place, -SOLE
    return level + heading.apply(pivot) - foot.apply(pivot), foot


def room(gap: Array, reach: float) -> float:
    """How far hips may rise until the longest leg is stretched to `reach`, a part of its length.

    Parameters
    ----------
    gap
        (F, 3) m from the hip to the ankle, world; where the leg is too short to get there, the
        hip would best be as low as the ankle.
    reach
        at most 1.
    """
    upright = (reach * (THIGH + SHIN)) ** 2 - (gap[:, :2] ** 2).sum(axis=1)
    return float((np.sqrt(np.maximum(upright, 0.0)) + gap[:, 2]).min())


@dataclass(frozen=True)
class PlantedLeg:
    """A leg whose foot is on the floor at times, and swings in between."""

    side: Side
    on: Mask  #: (F,) whether the foot is on the floor
    ankle: Array  #: (F, 3) m, world, while it is
    foot: Rotation  #: (F,) world, while it is
    keys: Array  #: (n, 8) that the leg swings through, of :func:`leg_keys`
    period: float | None = None  #: s, of a motion that repeats
    brake: float | None = None  #: s, as in :func:`bridged`
    wide: bool = False  #: whether the legs are spread

    def pose(self, times: Array, root: Array, pelvis: Rotation) -> Pose:
        """The leg's pose, for a root's path (F, 3)."""
        reached = leg_to(self.side, root, pelvis, self.ankle, self.foot, wide=self.wide)
        moved = bridged(times, self.on, reached, self.keys, period=self.period, brake=self.brake)
        return leg(self.side, moved)

    def room(self, root: Array, pelvis: Rotation, reach: float) -> float:
        """How far the root's path may rise until the standing leg is stretched to `reach`."""
        return room((self.ankle - socket(self.side, root, pelvis))[self.on], reach)


@dataclass(frozen=True)
class PlantedArm:
    """An arm whose hand is on the floor once, and that moves through keys before and after."""

    side: Side
    on: Mask  #: (F,) whether the hand is on the floor
    wrist: Array  #: (3,) m, world, while it is
    keys: Array  #: (n, 5) that the arm moves through, of :func:`arm_keys`; the ends are at rest
    near: Array  #: (3,) rad, near which the shoulder's map then is

    def pose(self, times: Array, root: Array, pelvis: Rotation, chest: Rotation) -> Pose:
        """The arm's pose, for a root's path (F, 3)."""
        place = np.tile(self.wrist, (len(times), 1))
        reached = arm_to(self.side, root, pelvis, chest, place, near=self.near)
        # Three frames at rest at either end, from which a bridge can leave.
        ends = np.ones_like(self.on)
        ends[3:-3] = False
        reached[:3], reached[-3:] = self.keys[0, 1:], self.keys[-1, 1:]
        return arm(self.side, bridged(times, self.on | ends, reached, self.keys))


def on_legs(upper: Pose, legs: Sequence[PlantedLeg], times: Array) -> Callable[[Array], Pose]:
    """What makes the pose for a root's path: `upper`, the root's rotation with it, and the `legs`."""

    def build(root: Array) -> Pose:
        pose = dict(upper)
        for each in legs:
            pose |= each.pose(times, root, upper["root"])
        return pose

    return build
