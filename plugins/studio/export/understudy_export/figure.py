"""What formats with bodies share: the figure in its rest pose, its surface, and where it moves."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import trimesh

from understudy_characters.shapes import bones
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.kinematics import need_skeleton
from understudy_motion.writing import Shape

Colour = tuple[float, float, float, float]

#: Edges sharper than this, in rad, are drawn as edges.
SHARP = np.pi / 5
#: Metres from the origin up to which float32 keeps a root position to a micrometre.
NEAR = 8.0


@dataclass(frozen=True)
class Surface:
    """All triangles of one colour in the rest pose; each vertex moves rigidly with one joint."""

    colour: Colour  #: linear RGBA
    positions: np.ndarray  #: (V, 3) m, z up, in the figure's frame
    normals: np.ndarray  #: (V, 3) unit
    faces: np.ndarray  #: (T, 3) rows of vertices, counter-clockwise seen from outside
    joints: np.ndarray  #: (V,) rows of joints


@dataclass(frozen=True)
class Figure:
    """A skeleton in its rest pose, in which all rotations are the identity, standing on z = 0."""

    skeleton: Skeleton
    rest_positions: np.ndarray  #: (J, 3) m, the joints in the figure's frame
    surfaces: tuple[Surface, ...]


def figure(clip: Clip, shapes: Sequence[Shape]) -> Figure:
    """The figure of `clip`, covered by `shapes`, or by bones where there are none.

    Raises
    ------
    FileError
        the clip has no skeleton.
    """
    skeleton = need_skeleton(clip)
    rest = np.zeros_like(skeleton.offsets)
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        rest[joint] = rest[parent] + skeleton.offsets[joint]
    shapes = shapes or list(bones(skeleton))
    rows = {name: row for row, name in enumerate(skeleton.joint_names)}
    rest[:, 2] -= min((rest[rows[s.joint]] + s.vertices)[:, 2].min() for s in shapes)
    by_colour: defaultdict[Colour, list[Shape]] = defaultdict(list)
    for shape in shapes:
        by_colour[shape.colour].append(shape)
    surfaces = []
    for colour, group in by_colour.items():
        meshes = [_shaded(shape) for shape in group]
        counts = [len(mesh.vertices) for mesh in meshes]
        joints = np.repeat([rows[shape.joint] for shape in group], counts)
        surfaces.append(
            Surface(
                colour,
                np.concatenate([mesh.vertices for mesh in meshes]) + rest[joints],
                np.concatenate([mesh.vertex_normals for mesh in meshes]),
                np.concatenate(
                    [
                        mesh.faces + start
                        for mesh, start in zip(meshes, np.cumsum([0, *counts]), strict=False)
                    ]
                ),
                joints,
            )
        )
    return Figure(skeleton, rest, tuple(surfaces))


def _shaded(shape: Shape) -> trimesh.Trimesh:
    """The shape with its vertices doubled along sharp edges, so that each has one normal."""
    mesh = trimesh.Trimesh(shape.vertices, shape.faces, process=False)
    return trimesh.graph.smooth_shade(mesh, angle=SHARP)


def origin(clip: Clip) -> np.ndarray:
    """(3,) m: the static place from which root positions are counted, so that float32 holds them.

    The world's origin if the motion stays within :data:`NEAR` of it, else the middle of its path.
    What float32 then rounds off is at most 2^-24 of the distance along each axis.
    """
    position = clip.root_position.numpy()
    if np.abs(position).max() <= NEAR:
        return np.zeros(3)
    return 0.5 * (position.min(axis=0) + position.max(axis=0))


def notice(clip: Clip) -> dict[str, Any]:
    """What a file says of its motion: licence, origin, whether it loops, and its frame rate."""
    texts = {
        "clip": clip.name,
        "licence": clip.licence,
        "attribution": clip.attribution,
        "source": clip.source,
        "url": clip.url,
    }
    known = {key: printable(text) for key, text in texts.items() if text}
    return {**known, "loop": clip.loop, "frame_rate": clip.frame_rate}


def printable(text: str) -> str:
    """`text` without what is no character or is not seen."""
    return "".join(filter(str.isprintable, text))
