"""A clip whose zero pose is no stance gets one that is, from how the figure moves.

Files of some programs put the x axis of every joint along its bone: with zero angles the figure is a
line, and how a thigh or a foot is turned about its bone cannot be read from it. The motion still says
it: on average a limb is turned as what it hangs on, and a leg that is straight stands. So is the trunk:
its frames, too, may be turned any way in the zero pose. Feet may point up or down in one that is a stance otherwise: how
they are flat on the floor says so.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from understudy_motion.clip import Clip, Skeleton
from understudy_motion.kinematics import forward_kinematics, need_skeleton
from understudy_retarget.anatomy import SIDES, Parts, path_up, rest_positions
from understudy_retarget.figure import BONES, Figure

#: Of a foot's length in its shin's: less may be the ankle's height above the sole.
_FOOT = 0.25
#: Of the frames of a clip: those with the ankle lowest, in which the foot is flat on the floor.
_FLAT = 0.1
#: Part along the vertical of a shin on a foot that is flat.
_UPRIGHT = 0.8
#: rad: by how much the pitch of feet that are flat may differ; what it may be (the clips of CMU and DeepMimic have up
#: to 0.23); and what it may be if they may stand on their toes.
_STEADY, _PITCHED, _ON_TOES = 0.25, 0.28, 0.45
#: rad: no leg is turned about itself by so much on average.
_TWISTED = 1.0
#: rad: nor an arm against what it hangs on, while it is not stretched backwards (the cosine of that); nor is a foot rolled
#: and turned against its shin. Recorded clips have up to 1.2, and 0.75.
_ROLLED, _BACKWARDS, _TILTED = 1.4, -0.3, 1.0
#: rad: nor a chest against its pelvis, which recorded clips have by up to 0.85 (a roll), or a head against its chest, by
#: 1.06.
_CROOKED, _BENT = 1.0, 1.3


def standing(clip: Clip, parts: Parts) -> tuple[Clip, tuple[str, ...]]:
    """The same motion with a zero pose that is a stance, and which limbs' zero pose was none
    (``trunk``, ``legs``, ``arms``, ``head``, ``feet``).

    Every joint of every frame is where it was. Of limbs that were none, joints are turned in the zero
    pose as they are on average against their parent, legs straight down, forearms along the upper
    arm, and feet as they are flat on the floor.
    """
    upright = _with_trunk(clip, parts)
    trunk = ("trunk",) if upright is not clip else ()
    clip = upright
    skeleton = need_skeleton(clip)
    figure, posed = Figure(skeleton, parts), _Posed(clip)
    # Of limbs on such a trunk a zero pose that could be a stance is one by chance.
    limbs = ("legs", "arms", "head") if trunk else tuple(_no_stance(figure, posed))
    feet = {} if {"legs", "feet"} & {*limbs} else _pitched_feet(skeleton, figure, posed)
    for joint, turn in feet.items():
        posed.fixed[joint] = turn
    if not limbs and not feet:
        return clip, trunk
    again = _below(skeleton, figure, limbs)
    carriers = {joint: segment for segment, joint in reversed(figure.segments.items())}
    for joint, parent in enumerate(skeleton.parents):
        if joint not in again:
            continue
        above = posed.turns[parent] * posed.fixed[parent]
        frames, segment = slice(None), carriers.get(joint, "")
        side, _, name = segment.partition("_")
        if name == "foot":
            height = figure.points[f"{side}_ankle"].track(*posed.tracks)[:, 2].numpy()
            frames, above = height <= np.quantile(height, _FLAT), _flat(above, figure.axes)
        average = (posed.turns[joint].inv() * above)[frames].mean()
        wanted = -figure.axes[:, 2] if name in ("thigh", "shin") else None
        if name == "forearm" and (upper := posed.along(figure, f"{side}_upper_arm")) is not None:
            carrier = figure.segments[f"{side}_upper_arm"]
            wanted = posed.fixed[carrier].apply(upper, inverse=True)
        if wanted is not None and (bone := posed.along(figure, segment)) is not None:
            average = average * Rotation.align_vectors(average.apply(bone, inverse=True), wanted)[0]
        posed.fixed[joint] = average
    return _refixed(clip, skeleton, posed.fixed), (*trunk, *limbs, *(("feet",) if feet else ()))


def _with_trunk(clip: Clip, parts: Parts) -> Clip:
    """`clip` with a zero pose whose trunk stands, if its own is not as the trunk is on average: the pelvis by where
    the hips and, on average, the chest are in its frame, what is between it and the chest parallel to it."""
    skeleton = need_skeleton(clip)
    pelvis, chest = (parts[part][-1] if part in parts else 0 for part in ("pelvis", "chest"))
    ends = {f"{side}_{part}" for side in SIDES for part in ("hip", "shoulder")}
    if pelvis == chest or not ends <= set(parts):
        return clip
    posed = _Posed(clip)
    origins = posed.tracks[0].numpy()
    at = {part: origins[:, parts[part][0]] for part in ends}
    middle = [0.5 * (at[f"left_{part}"] + at[f"right_{part}"]) for part in ("shoulder", "hip")]
    rest = rest_positions(skeleton)
    spine = rest[[parts[f"{side}_shoulder"][0] for side in SIDES]].mean(axis=0)
    spine = spine - rest[[parts[f"{side}_hip"][0] for side in SIDES]].mean(axis=0)

    def within(track: np.ndarray) -> np.ndarray:
        return posed.turns[pelvis].apply(track, inverse=True).mean(axis=0)

    left, up = within(at["left_hip"] - at["right_hip"]), within(middle[0] - middle[1])
    bent = np.arctan2(np.linalg.norm(np.cross(spine, up)), spine @ up)
    turned = (posed.turns[pelvis].inv() * posed.turns[chest]).mean().magnitude()
    if max(bent, turned) <= _CROOKED:
        return clip
    forward = np.cross(left, up)
    if np.linalg.norm(forward) < 0.1 * np.linalg.norm(left) * np.linalg.norm(up):
        return clip
    axes = (forward, left, np.cross(forward, left))
    own = Rotation.from_matrix(np.column_stack([axis / np.linalg.norm(axis) for axis in axes]))
    for joint in {*path_up(skeleton, pelvis), *path_up(skeleton, chest)}:
        posed.fixed[joint] = (posed.turns[joint].inv() * posed.turns[pelvis]).mean() * own
    return _refixed(clip, skeleton, posed.fixed)


class _Posed:
    """A clip's frames: where its joints are, and by how much each one's frame is turned anew."""

    def __init__(self, clip: Clip) -> None:
        self.tracks = forward_kinematics(clip)
        world = self.tracks[1].numpy()
        self.turns = [Rotation.from_quat(w, scalar_first=True) for w in world.swapaxes(0, 1)]
        self.fixed = [Rotation.identity()] * len(self.turns)

    def along(self, figure: Figure, bone: str) -> np.ndarray | None:
        """(3,): the bone's direction in the frame of the joint that carries it, on average."""
        start, end = BONES[bone]
        if bone not in figure.segments or not {start, end} <= set(figure.points):
            return None
        begins, ends = (figure.points[part].track(*self.tracks).numpy() for part in (start, end))
        local = self.turns[figure.segments[bone]].apply(ends - begins, inverse=True).mean(axis=0)
        length = float(np.linalg.norm(local))
        return local / length if length > 1e-6 else None


def _flat(above: Rotation, axes: np.ndarray) -> Rotation:
    """A foot flat on the floor, below a shin that is turned by `above`; `axes` are the zero pose's."""
    body = Rotation.from_matrix(axes)
    forward = (above * body).apply([1.0, 0.0, 0.0])
    yaw = np.arctan2(forward[:, 1], forward[:, 0])
    return Rotation.from_euler("z", yaw[:, None]) * body.inv()


def _pitched_feet(skeleton: Skeleton, figure: Figure, posed: _Posed) -> dict[int, Any]:
    """The joints of feet that point up or down in the zero pose of a figure whose legs stand in it, and how each is
    turned anew: by the pitch that the foot has, usually, while it is flat on the floor.

    Both feet have to, by about as much. Runners land and dancers stand on their toes, so where the zero pose may be
    right the motion has to say otherwise plainly.
    """
    body = Rotation.from_matrix(figure.axes)
    pitches, rises = [], [0.0]
    joints: set[int] = set()
    for side in SIDES:
        foot, shin = (figure.segments.get(f"{side}_{name}") for name in ("foot", "shin"))
        if foot is None or shin is None or foot == shin or f"{side}_ankle" not in figure.points:
            return {}
        height = figure.points[f"{side}_ankle"].track(*posed.tracks)[:, 2].numpy()
        upright = (posed.turns[shin] * body).apply([0.0, 0.0, 1.0])[:, 2] > _UPRIGHT
        flat = (height <= np.quantile(height, _FLAT)) & upright
        if not flat.any():
            return {}
        ahead = (body.inv() * posed.turns[foot] * body)[flat].apply([1.0, 0.0, 0.0])
        low, pitch, high = np.quantile(np.arcsin(ahead[:, 2].clip(-1.0, 1.0)), (0.25, 0.5, 0.75))
        if high - low > _STEADY:
            return {}
        pitches.append(float(pitch))
        joints |= {j for j in range(len(skeleton.parents)) if foot in path_up(skeleton, j)}
        if f"{side}_toe" in figure.points:
            along = figure.between(f"{side}_ankle", f"{side}_toe")
            rises.append(float(np.arctan2(along[2], np.linalg.norm(along[:2]))))
    pitch = float(np.mean(pitches))
    least = -_ON_TOES if max(rises) < 0.5 * _PITCHED else -_PITCHED
    if np.ptp(pitches) > _STEADY or least <= pitch <= _PITCHED:
        return {}
    level: Any = body * Rotation.from_euler("y", pitch) * body.inv()
    return dict.fromkeys(joints, level)


def _no_stance(figure: Figure, posed: _Posed) -> Iterator[str]:
    """The limbs of which the zero pose is none that a figure could stand in."""

    def along(start: str, end: str) -> np.ndarray | None:
        """(3,): the direction in the zero pose: forward, left, up."""
        if start not in figure.points or end not in figure.points:
            return None
        length = figure.length(start, end)
        return None if length < 1e-6 else figure.between(start, end) / length

    def leg(side: str) -> bool:
        for bone in (along(f"{side}_hip", f"{side}_knee"), along(f"{side}_knee", f"{side}_ankle")):
            if bone is not None and bone[2] > -0.5:
                return False
        if any(abs(_twist(figure, posed, side, part)) > _TWISTED for part in ("thigh", "shin")):
            return False
        foot = along(f"{side}_ankle", f"{side}_toe")
        if foot is None:
            return True
        shin = figure.length(f"{side}_knee", f"{side}_ankle")
        long = figure.length(f"{side}_ankle", f"{side}_toe") > _FOOT * shin
        return bool(foot[0] > -0.3 and abs(foot[1]) < 0.8 and foot[2] < 0.7) and not (
            long and foot[2] < -0.9
        )

    def arm(side: str) -> bool:
        upper = along(f"{side}_shoulder", f"{side}_elbow")
        lower = along(f"{side}_elbow", f"{side}_wrist")
        if upper is None:
            return True
        out = upper[1] if side == "left" else -upper[1]
        straight = lower is None or float(upper @ lower) > 0.0
        bones = [
            (f"{side}_upper_arm", "chest", upper),
            (f"{side}_forearm", f"{side}_upper_arm", lower),
        ]
        if any(_rolled(figure, posed, *bone) > _ROLLED for bone in bones):
            return False
        return bool(upper[2] < 0.5 and out > -0.5 and abs(upper[0]) < 0.9) and straight

    if not all(map(leg, SIDES)):
        yield "legs"
    elif any(_tilted(figure, posed, side) > _TILTED for side in SIDES):
        yield "feet"
    if not all(map(arm, SIDES)):
        yield "arms"
    head = along("chest", "head")
    if (head is not None and head[2] < 0.3) or _turned_head(figure, posed) > _BENT:
        yield "head"


def _turned_head(figure: Figure, posed: _Posed) -> float:
    """rad: by how much the head is turned against the chest, on average."""
    head, chest = figure.segments.get("head"), figure.segments.get("chest")
    if head is None or chest is None:
        return 0.0
    return float((posed.turns[chest].inv() * posed.turns[head]).mean().magnitude())


def _rolled(
    figure: Figure, posed: _Posed, segment: str, holds: str, bone: np.ndarray | None
) -> float:
    """rad: by how much an arm's segment is turned about its `bone` (3,), on average, against what `holds` it; 0 where it is
    bent so far that this says nothing."""
    joints = figure.segments.get(segment), figure.segments.get(holds)
    if bone is None or None in joints or joints[0] == joints[1]:
        return 0.0
    turned = _against(figure, posed, segment, holds)
    w, *axis = turned.as_quat(scalar_first=True)
    if turned.apply(bone) @ bone < _BACKWARDS:
        return 0.0
    return abs(2.0 * float(np.arctan2(np.array(axis) @ bone, abs(w))))


def _tilted(figure: Figure, posed: _Posed, side: str) -> float:
    """rad: by how much a foot is rolled and turned, or beyond that pitched, against its shin, on average."""
    foot, shin = (figure.segments.get(f"{side}_{name}") for name in ("foot", "shin"))
    if foot is None or shin is None or foot == shin:
        return 0.0
    roll, pitch, yaw = _against(figure, posed, f"{side}_foot", f"{side}_shin").as_rotvec()
    return float(max(np.hypot(roll, yaw), abs(pitch) - _PITCHED))


def _against(figure: Figure, posed: _Posed, segment: str, holds: str) -> Any:
    """The segment's turn against another one, on average: in forward, left, up of the zero pose."""
    body = Rotation.from_matrix(figure.axes)
    own, above = (posed.turns[figure.segments[name]] for name in (segment, holds))
    return body.inv() * (above.inv() * own).mean() * body


def _twist(figure: Figure, posed: _Posed, side: str, bone: str) -> float:
    """rad: by how much the segment is turned about itself against the pelvis, on average."""
    carrier, pelvis = figure.segments.get(f"{side}_{bone}"), figure.segments.get("pelvis")
    if carrier is None or pelvis is None or carrier == pelvis:
        return 0.0
    body = Rotation.from_matrix(figure.axes)
    turned = body.inv() * (posed.turns[pelvis].inv() * posed.turns[carrier]).mean() * body
    w, _, _, z = turned.as_quat(scalar_first=True)
    return float(2.0 * np.arctan2(z, w) if w >= 0.0 else 2.0 * np.arctan2(-z, -w))


def _below(skeleton: Skeleton, figure: Figure, limbs: tuple[str, ...]) -> set[int]:
    """The joints of these limbs: those that hang on the pelvis, or on the chest, by the limb's first."""
    first = {"legs": ("hip", "pelvis"), "arms": ("shoulder", "chest"), "head": ("head", "chest")}
    tops = set()
    for limb in limbs:
        if limb == "feet":
            tops.update(figure.parts[f"{side}_ankle"][0] for side in SIDES)
            continue
        part, trunk = first[limb]
        for name in (part, *(f"{side}_{part}" for side in SIDES)):
            if name not in figure.parts:
                continue
            joint, holds = figure.parts[name][0], figure.parts.get(trunk, (0,))[-1]
            while skeleton.parents[joint] not in (holds, -1):
                joint = skeleton.parents[joint]
            tops.add(joint)
    tops.discard(0)
    return {j for j in range(len(skeleton.parents)) if tops & set(path_up(skeleton, j))}


def _refixed(clip: Clip, skeleton: Skeleton, fixed: list[Rotation]) -> Clip:
    """`clip` with each joint's frame turned by `fixed`, in that frame."""
    locals_, offsets, tips = [], skeleton.offsets.copy(), dict(skeleton.tips)
    for joint, parent in enumerate(skeleton.parents):
        turn = Rotation.from_quat(clip.rotations[:, joint].numpy(), scalar_first=True)
        above = fixed[parent] if parent >= 0 else Rotation.identity()
        turned = above.inv() * turn * fixed[joint]
        locals_.append(torch.from_numpy(turned.as_quat(scalar_first=True)))
        offsets[joint] = above.apply(offsets[joint], inverse=True)
        name = skeleton.joint_names[joint]
        if name in tips:
            tips[name] = fixed[joint].apply(tips[name], inverse=True)
    own = replace(skeleton, offsets=offsets, tips=tips)
    return replace(clip, rotations=torch.stack(locals_, dim=1), skeleton=own)
