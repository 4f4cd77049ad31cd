"""Biovision hierarchy (BVH): a skeleton, then Euler angles in degrees, frame by frame; some programs write radians.

The format as described by J. Lander, "Working with Motion Capture File Formats", Game Developer,
January 1998: a joint's rotation is the product of its rotation channels in the order listed, the
last applied first. An End Site is the tip of the joint that it is in; it may have channels, which turn nothing. With all angles zero all frames
are parallel. Of joints with the same name the later ones get a number.

Position channels replace the joint's OFFSET, so constant ones are its bone. Where they would make the
figure a point beside its OFFSETs they are displacements from these. Only the root moves; nodes of a
scene above hips that move are left out, and the hips take their place and turn in the world.
What a program writes below the last frame, such as its name or a list of events, is left out; a second
motion there is refused.

A BVH says neither its unit nor its vertical axis. What is not given is recognised:

- The vertical axis is the one of y and z along which the figure is much the longer, in the pose of
  zeros and in the first frame; one of the two may be undecided (bones laid out along x, crouching).
- The unit of angles is degrees, unless no angle is beyond a turn in radians, and as degrees they would leave a
  figure all but still that travels, or that does not stand on its floor.
- The unit is metres, centimetres, millimetres, inches or feet if that makes the figure an adult, else
  one of the first three if that makes it between 0.4 and 3 m tall, else that of the CMU database
  (1 / 0.45 inch) if that makes it an adult.

Files with y up are taken to face z, as is the custom; see
:func:`understudy_motion.readers.frames.to_world`.
"""

from __future__ import annotations

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.limits import checked_skeleton, read_bytes
from understudy_motion.origin import provenance
from understudy_motion.readers.bvh_hierarchy import Hierarchy, Joint
from understudy_motion.readers.bvh_motion import read_motion
from understudy_motion.readers.frames import product_of_turns, to_world
from understudy_motion.readers.guesses import are_radians, may_be_radians, unit_of_height
from understudy_motion.readers.text import decoded, without_comments
from understudy_motion.reading import (
    HEAD_BYTES,
    METRES,
    UNSAID,
    Axis,
    ClipReader,
    ReadOptions,
    metres_of,
)
from understudy_tensors import rotations

TALLER = 1.5
"""How many times longer than along the other axis a figure must be along the vertical one."""
MOVING = 1e-3
"""m that a joint's position may differ from its bone."""
SHIFTED, TRAVELLING = 1e-4, 1e-2
"""Moving and plainly moving, in lengths of all bones together, while the unit is not known."""
UNSCALED = 1e-3
"""What a scale may differ from 1."""
COLLAPSED = 0.1
"""Positions whose bones are together so much of the OFFSETs' length are displacements from these."""


@dataclass
class Bone:
    """A joint and where it is against its parent, lengths in the file's unit and frame."""

    name: str
    parent: int
    offset: np.ndarray  #: (3,)
    tip: tuple[float, ...] | None
    axes: tuple[int, ...]  #: about which it turns, the last applied first
    angles: np.ndarray  #: (F, axes) degrees
    positions: np.ndarray  #: (F, 3)
    above: int = 0  #: how many of its axes, the first ones, are of nodes above the figure

    def turns(self, up: Axis) -> torch.Tensor:
        """(F, 4), in the frame with z up."""
        return product_of_turns(to_world(np.eye(3)[list(self.axes)], up), np.radians(self.angles))

    def moves(self, distance: float) -> bool:
        """Whether its position changes by more than `distance`."""
        return bool((np.ptp(self.positions, axis=0) > distance).any())


class BvhReader(ClipReader):
    """Reads BVH."""

    fixed = MappingProxyType({"skeleton": None})
    suffixes = (".bvh",)

    def recognises(self, head: bytes, path: Path) -> bool:
        lines = without_comments(decoded(head).splitlines())
        remarks = len(head) == HEAD_BYTES and len(lines) > 1 and not any(lines[:-1])
        if remarks:  # which go on beyond it
            return path.suffix.lower() in self.suffixes
        return any(line[:9].upper() == "HIERARCHY" for line in lines)

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path)
        lines = without_comments(decoded(content).splitlines())
        for i, line in enumerate(lines):  # a remark in whatever marks
            if line[:9].upper() == "HIERARCHY":
                break
            lines[i] = ""
        hierarchy = Hierarchy(path, lines)
        joints, motion = hierarchy.parse()
        interval, values = read_motion(path, lines, motion, joints, hierarchy.columns, options.rate)
        bones = _figure(path, joints, values)

        def clip(bones: Sequence[Bone], up: Axis, metres: float) -> Clip:
            for bone in bones[1:]:
                _check_still(path, bone, metres)
            position = bones[0].positions
            return Clip(
                name=path.stem,
                times=torch.arange(len(position), dtype=torch.float64) / rate,
                root_position=torch.from_numpy(to_world(metres * position, up)),
                rotations=torch.stack([bone.turns(up) for bone in bones], dim=1),
                joint_names=tuple(bone.name for bone in bones),
                loop=bool(options.loop),
                skeleton=_skeleton(path, bones, metres, up),
                **provenance(path, content),
            )

        rate = options.rate or 1.0 / interval
        if options.angles is not None:
            turned = options.angles == "radians"
            bones = _figure(path, joints, values, np.degrees(1.0)) if turned else bones
            return clip(bones, *_recognised(path, bones, options))
        if not may_be_radians(np.concatenate([bone.angles.ravel() for bone in bones])):
            return clip(bones, *_recognised(path, bones, options))
        wide = _figure(path, joints, values, np.degrees(1.0))
        try:
            frame = _recognised(path, bones, options)
        except FileError as error:
            with contextlib.suppress(FileError):
                frame = _recognised(path, wide, options)
                if are_radians(clip(wide, *frame), clip(bones, *frame)):
                    return clip(wide, *frame)
            raise error
        given = clip(bones, *frame)
        with contextlib.suppress(FileError):
            turned = clip(wide, *_recognised(path, wide, options))
            return turned if are_radians(turned, given) else given
        return given


def _figure(
    path: Path, joints: Sequence[Joint], values: Sequence[np.ndarray], degrees: float = 1.0
) -> list[Bone]:
    """The joints that are the figure's, the first its root, with their bones and angles, of which the file's unit is
    so many `degrees`."""
    bones = []
    for joint, numbers in zip(joints, values, strict=True):
        positions = np.tile(np.array(joint.offset), (len(numbers), 1))
        for column, k in joint.columns("position"):
            positions[:, k] = numbers[:, column]
        sizes = numbers[:, [column for column, _ in joint.columns("scale")]]
        if (np.abs(sizes - 1.0) > UNSCALED).any():
            raise FileError(
                f"Clip {path}: joint '{joint.name}' changes its size; export the motion without scale."
            )
        turning = joint.columns("rotation")
        bones.append(
            Bone(
                joint.name, joint.parent, np.array(joint.offset), joint.tip,
                tuple(k for _, k in turning), degrees * numbers[:, [c for c, _ in turning]], positions,
            )
        )  # fmt: skip
    if len(bones[0].positions):
        _settle_bones(joints, bones)
        bones = _from_root(bones, _top(bones))
    return bones


def _settle_bones(joints: Sequence[Joint], bones: Sequence[Bone]) -> None:
    """Tell positions from displacements, and make each bone what the positions say."""
    placed = [bones[i] for i, joint in enumerate(joints) if i and joint.columns("position")]
    medians = [np.median(bone.positions, axis=0) for bone in placed]
    # Hips below a node of the scene travel, and say nothing about bones.
    said = [
        (np.linalg.norm(median), np.linalg.norm(bone.offset))
        for bone, median in zip(placed, medians, strict=True)
        if bone.parent
    ] or [
        (np.linalg.norm(median), np.linalg.norm(bone.offset))
        for bone, median in zip(placed, medians, strict=True)
    ]
    if said and sum(p for p, _ in said) < COLLAPSED * sum(o for _, o in said):
        for bone in placed:
            bone.positions += bone.offset
        start, root = bones[0].positions[0], bones[0].offset
        if joints[0].columns("position") and np.linalg.norm(start) < np.linalg.norm(start - root):
            bones[0].positions += root
        medians = [np.median(bone.positions, axis=0) for bone in placed]
    near = SHIFTED * _length(bones)
    for bone, median in zip(placed, medians, strict=True):
        if np.abs(median - bone.offset).max() > near:
            bone.offset = median


def _length(bones: Sequence[Bone]) -> float:
    """Of all bones together, but those at the root, which may be a path through the scene."""
    return float(sum(np.linalg.norm(bone.offset) for bone in bones if bone.parent > 0))


def _top(bones: Sequence[Bone]) -> int:
    """The joint that is the figure's root: the hips, where nodes of a scene are above them."""
    length = _length(bones)
    sizes = np.ones(len(bones), dtype=int)
    children: list[list[int]] = [[] for _ in bones]
    for joint in range(len(bones) - 1, 0, -1):
        sizes[bones[joint].parent] += sizes[joint]
        children[bones[joint].parent].append(joint)
    at = top = 0
    still = True
    while children[at]:
        still = still and not bones[at].moves(SHIFTED * length)
        still = still and bool((np.ptp(bones[at].angles, axis=0) <= 1e-3).all())
        main = max(children[at], key=lambda joint: sizes[joint])
        if len(children[at]) == 1:
            if bones[main].moves(SHIFTED * length) and (still or len(children[main]) > 1):
                top = main
        elif still and bones[main].moves(TRAVELLING * length):
            top = main  # beside it are handles and markers, which are not part of the figure
        else:
            break
        at = main
    return top


def _from_root(bones: Sequence[Bone], top: int) -> list[Bone]:
    """The bones of `top` and below; it takes its place and turn in the world."""
    if top == 0:
        return list(bones)
    root = bones[top]
    axes, angles, positions = root.axes, root.angles, root.positions
    at = root.parent
    while at >= 0:
        above = bones[at]
        turn = above.turns("z")
        positions = above.positions + rotations.rotate(turn, torch.from_numpy(positions)).numpy()
        axes = (*above.axes, *axes)
        angles = np.concatenate((above.angles, angles), axis=1)
        at = above.parent
    kept = {top: 0}
    nodes = len(axes) - len(root.axes)
    found = [replace(root, parent=-1, axes=axes, angles=angles, positions=positions, above=nodes)]
    for joint, bone in enumerate(bones):
        if bone.parent in kept:
            kept[joint] = len(found)
            found.append(replace(bone, parent=kept[bone.parent]))
    return found


def _skeleton(path: Path, bones: Sequence[Bone], metres: float, up: Axis) -> Skeleton:
    return checked_skeleton(
        path,
        [bone.name for bone in bones],
        [bone.parent for bone in bones],
        to_world(metres * np.array([bone.offset for bone in bones]), up),
        {b.name: to_world(metres * np.array(b.tip), up) for b in bones if b.tip is not None},
    )


def _check_still(path: Path, bone: Bone, metres: float) -> None:
    """Refuse a joint that moves against its parent: its bone would change length."""
    strays = metres * np.abs(bone.positions - bone.offset).max(axis=1) > MOVING
    if strays.any():
        raise FileError(
            f"Clip {path}: frame {int(strays.argmax())}: joint '{bone.name}' moves against its "
            "parent, by more than 1 mm; only the root may, so export the motion with bones of fixed "
            "length."
        )


def _recognised(path: Path, bones: Sequence[Bone], options: ReadOptions) -> tuple[Axis, float]:
    """The vertical axis and the metres in a unit of length, of which either may be given."""
    up = options.up
    if up is not None and options.unit is not None:
        return up, metres_of(options.unit)
    extents = _extents(path, bones)
    up = up or _vertical(extents)
    if up is None:
        raise FileError(
            f"Clip {path}: which axis is vertical cannot be told from the figure; give motion.up=y "
            "or z (--up)."
        )
    if options.unit is not None:
        return up, metres_of(options.unit)
    metres = unit_of_height(extents[:, "xyz".index(up)].max())
    if metres is None:
        raise FileError(
            f"Clip {path}: its unit of length cannot be told from the figure; give motion.unit, one "
            f"of {', '.join(METRES)}, or the metres in a unit (--unit)."
        )
    return up, metres


def _extents(path: Path, bones: Sequence[Bone]) -> np.ndarray:
    """(3, 3): the figure's size along each axis, file's unit, with zero angles, with those of nodes above
    it alone, and in frame 0."""
    first = [bone.angles[:1] for bone in bones]
    zeros = [a * (np.arange(a.shape[1]) < b.above) for a, b in zip(first, bones, strict=True)]
    turns = [
        torch.stack([replace(b, angles=a).turns("z") for b, a in zip(bones, pose, strict=True)], 1)
        for pose in ([np.zeros_like(a) for a in first], zeros, first)
    ]
    poses = Clip(
        name=path.stem,
        times=torch.arange(3.0),
        root_position=torch.zeros(3, 3),
        rotations=torch.cat(turns),
        joint_names=tuple(bone.name for bone in bones),
        loop=False,
        skeleton=_skeleton(path, bones, 1.0, "z"),
        source=str(path),
    )
    positions, world = forward_kinematics(poses)
    points = torch.cat((positions, tip_positions(poses, positions, world)), dim=1)
    return (points.amax(dim=1) - points.amin(dim=1)).numpy()


def _vertical(extents: np.ndarray) -> Axis | None:
    """The axis along which figures of these sizes (:func:`_extents`) stand, None if that is not plain."""

    def vote(size: np.ndarray) -> Axis | None:
        x, y, z = size
        if y > TALLER * z and y > 0.5 * x:
            return "y"
        return "z" if z > TALLER * y and z > 0.5 * x else None

    votes: list[Axis | None] = [vote(size) for size in extents]
    zeros, turned, first = votes
    axis = turned or zeros
    return None if axis and first and axis != first else axis or first
