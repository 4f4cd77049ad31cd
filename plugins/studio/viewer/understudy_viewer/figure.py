"""A clip as something to draw: rigid parts, their poses in all frames, contacts and footprints."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial import ConvexHull
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.contacts import feet, foot_points
from understudy_characters.shapes import bones, shapes
from understudy_doctor.examination import foot_contacts
from understudy_motion.clip import Clip, Skeleton, sample
from understudy_motion.kinematics import forward_kinematics, need_skeleton
from understudy_motion.writing import Shape
from understudy_tensors import rotations

#: m: footprints lie this much above the ground, so as to be seen.
_PRINT_HEIGHT = 0.004


@dataclass(frozen=True)
class Mesh:
    """Triangles."""

    vertices: np.ndarray  #: (V, 3) m
    faces: np.ndarray  #: (T, 3) rows of vertices, counter-clockwise seen from outside


@dataclass(frozen=True)
class Figure:
    """A figure and its motion. F frames, P rigid parts."""

    parts: tuple[Mesh, ...]  #: each in the frame of its joint
    positions: np.ndarray  #: (F, P, 3) m, world
    rotations: np.ndarray  #: (F, P, 4), world
    root: np.ndarray  #: (F, 3) m, world
    reach: float  #: m, the length of the longest way through the skeleton from the root
    feet: tuple[str, ...]  #: names; none where no character says what the feet are
    foot_parts: tuple[int, ...]  #: the part of each foot
    contacts: np.ndarray  #: (F, feet) bool
    footprints: Mesh  #: world, one print for each time that a foot is down


def figure(clip: Clip, character: Character | None, times: Tensor) -> Figure:
    """The figure of `clip` at `times` (F,) s from 0, as `character`, or as bones if that is None.

    Raises
    ------
    FileError
        the clip lacks a joint of the character or, without one, has no skeleton.
    """
    loop = clip.loop and times[-1].item() == clip.duration
    if character is None:
        position, rotation = sample(clip, times)
        own = replace(clip, times=times, root_position=position, rotations=rotation, loop=loop)
        surface = list(bones(need_skeleton(own)))
    else:
        qpos = character.qpos(clip, times)
        own = character.clip(qpos, times, name=clip.name, loop=loop, source=clip.source)
        surface = shapes(character)
    positions, turns = forward_kinematics(own)
    by_joint: defaultdict[int, list[Shape]] = defaultdict(list)
    for shape in surface:
        by_joint[own.joint_names.index(shape.joint)].append(shape)
    names: tuple[str, ...] = ()
    contacts = np.zeros((len(times), 0), dtype=bool)
    prints = Mesh(np.zeros((0, 3)), np.zeros((0, 3), dtype=int))
    if character is not None:
        names = feet(character)
        contacts, ground = foot_contacts(clip, character, times)
        prints = _footprints(character, contacts, ground, positions, turns)
    joints = list(by_joint)
    return Figure(
        parts=tuple(_joined(group) for group in by_joint.values()),
        positions=positions[:, joints].numpy(),
        rotations=turns[:, joints].numpy(),
        root=own.root_position.numpy(),
        reach=_reach(need_skeleton(own)),
        feet=names,
        foot_parts=tuple(joints.index(own.joint_names.index(name)) for name in names),
        contacts=contacts,
        footprints=prints,
    )


def intervals(on: np.ndarray) -> np.ndarray:
    """(I, 2): first frame and the frame after the last one of each stretch in which `on` (F,) holds."""
    edges = np.diff(np.concatenate([[False], on, [False]]).astype(int))
    return np.stack([np.flatnonzero(edges == 1), np.flatnonzero(edges == -1)], axis=1)


def _joined(group: Sequence[Shape]) -> Mesh:
    starts = np.cumsum([0, *(len(shape.vertices) for shape in group)])
    return Mesh(
        np.concatenate([shape.vertices for shape in group]),
        np.concatenate([s.faces + start for s, start in zip(group, starts, strict=False)]),
    )


def _reach(skeleton: Skeleton) -> float:
    far = np.zeros(len(skeleton.parents))
    lengths = np.linalg.norm(skeleton.offsets, axis=1)
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        far[joint] = far[parent] + lengths[joint]
    return float(far.max())


def _footprints(
    character: Character, contacts: np.ndarray, ground: float, positions: Tensor, turns: Tensor
) -> Mesh:
    """The outline of each foot on the ground, in the middle of each time that it is down."""
    vertices, faces, count = [np.zeros((0, 3))], [np.zeros((0, 3), dtype=int)], 0
    for column, (name, points) in enumerate(foot_points(character).items()):
        joint = character.joint_names.index(name)
        middle = intervals(contacts[:, column]).sum(axis=1) // 2
        sole = positions[middle, joint, None] + rotations.rotate(turns[middle, joint, None], points)
        for flat in sole[..., :2].numpy():
            corners = np.unique(flat.round(5), axis=0)
            outline = corners[ConvexHull(corners, qhull_options="QJ").vertices]
            fan = np.arange(1, len(outline) - 1)
            vertices.append(np.insert(outline, 2, ground + _PRINT_HEIGHT, axis=1))
            faces.append(count + np.stack([np.zeros_like(fan), fan, fan + 1], axis=1))
            count += len(outline)
    return Mesh(np.concatenate(vertices), np.concatenate(faces))
