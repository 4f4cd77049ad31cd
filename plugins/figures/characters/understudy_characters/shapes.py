"""A figure's surface: a character's geoms, or bones, as triangle meshes fixed to its joints."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import lru_cache
from typing import TYPE_CHECKING

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character, Geom
from understudy_motion.clip import Skeleton
from understudy_motion.writing import Shape

if TYPE_CHECKING:
    import trimesh

__all__ = ["bones", "shapes", "surface_points"]

#: Metres across that mark a joint from which no bone leads on.
MARKER = 0.02


def shapes(character: Character, geoms: Sequence[Geom] | None = None) -> list[Shape]:
    """The `geoms` of `character`, by default all, as triangle meshes in the frames of its joints.

    Curved geoms are tessellated, about 300 triangles each. Their colours are the model's.
    """
    model = character.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = data.xmat[character.root].reshape(3, 3)
    result = []
    for geom in character.shown if geoms is None else geoms:
        mesh = _mesh(character, geom.id)
        turn = root.T @ data.geom_xmat[geom.id].reshape(3, 3)
        centre = geom.centre - character.rest_positions[geom.joint]
        colour = model.geom_rgba[geom.id]
        if model.geom_matid[geom.id] >= 0:
            colour = model.mat_rgba[model.geom_matid[geom.id]]
        result.append(
            Shape(
                character.joint_names[geom.joint],
                mesh.vertices @ turn.T + centre,
                np.asarray(mesh.faces),
                (float(colour[0]), float(colour[1]), float(colour[2]), float(colour[3])),
            )
        )
    return result


def body_shapes(character: Character, body: int) -> list[Shape]:
    """All geoms of `body` in the character's model that are seen, except planes, in the body's frame."""
    model, found = character.model, []
    name = model.body(body).name or f"body{body}"
    for geom in range(model.ngeom):
        if model.geom_bodyid[geom] != body or model.geom_type[geom] == mujoco.mjtGeom.mjGEOM_PLANE:
            continue
        r, g, b, a = (float(part) for part in model.geom_rgba[geom])
        if a == 0.0:
            continue
        mesh, turn = _mesh(character, geom), np.zeros(9)
        mujoco.mju_quat2Mat(turn, model.geom_quat[geom])
        vertices = mesh.vertices @ turn.reshape(3, 3).T + model.geom_pos[geom]
        found.append(Shape(name, vertices, np.asarray(mesh.faces), (r, g, b, a)))
    return found


def _mesh(character: Character, geom: int) -> trimesh.Trimesh:
    kind, size = int(character.model.geom_type[geom]), character.model.geom_size[geom]
    import trimesh  # a third of a second, and few ask for surfaces

    make, types = trimesh.creation, mujoco.mjtGeom
    if kind == types.mjGEOM_SPHERE:
        return make.icosphere(subdivisions=2, radius=size[0])
    if kind == types.mjGEOM_CAPSULE:
        mesh = make.capsule(height=2 * size[1], radius=size[0], count=[16, 12])
        mesh.apply_translation(-mesh.bounds.mean(axis=0))
        return mesh
    if kind == types.mjGEOM_CYLINDER:
        return make.cylinder(radius=size[0], height=2 * size[1], sections=24)
    if kind == types.mjGEOM_BOX:
        return make.box(extents=2 * size)
    if kind == types.mjGEOM_ELLIPSOID:
        mesh = make.icosphere(subdivisions=2)
        mesh.apply_scale(size)
        return mesh
    vertices, faces = character.mesh(geom)
    return trimesh.Trimesh(vertices, faces, process=False)


def bones(skeleton: Skeleton) -> Iterator[Shape]:
    """Octahedra from each joint to its children and its tip; a small one around a joint that has neither."""
    ends: dict[int, list[np.ndarray]] = {row: [] for row in range(len(skeleton.joint_names))}
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        ends[parent].append(skeleton.offsets[joint])
    for name, tip in skeleton.tips.items():
        ends[skeleton.joint_names.index(name)].append(np.asarray(tip))
    for row, name in enumerate(skeleton.joint_names):
        long = [end for end in ends[row] if np.linalg.norm(end) > MARKER]
        for end in long:
            yield _octahedron(name, np.zeros(3), end, waist=0.2, width=0.2)
        if not long:
            half = np.array([0.0, 0.0, 0.5 * MARKER])
            yield _octahedron(name, -half, half, waist=0.5, width=1.0)


def _octahedron(
    joint: str, start: np.ndarray, end: np.ndarray, *, waist: float, width: float
) -> Shape:
    """From `start` to `end`; its square waist lies at the share `waist` of its length and is as wide
    as the share `width` of it."""
    along = end - start
    across = np.cross(along, np.eye(3)[np.argmin(np.abs(along))])
    across *= 0.5 * width * np.linalg.norm(along) / np.linalg.norm(across)
    beside = np.cross(along, across) / np.linalg.norm(along)
    middle = start + waist * along
    ring = [middle + across, middle + beside, middle - across, middle - beside]
    faces = [
        face
        for first, second in ((1, 2), (2, 3), (3, 4), (4, 1))
        for face in ((0, second, first), (5, first, second))
    ]
    return Shape(joint, np.array([start, *ring, end]), np.array(faces))


@lru_cache(maxsize=8)  # each look at a clip asks for it anew
def surface_points(character: Character) -> tuple[np.ndarray, Tensor]:
    """The vertices of each geom that are outermost in 26 directions: their joints' rows (P,), in order, and their places
    in the joints' frames (P, 3)."""
    grid = np.array(np.meshgrid(*[[-1, 0, 1]] * 3)).reshape(3, -1).T
    directions = grid[np.abs(grid).sum(1) > 0]
    owners, points = [], []
    for shape in shapes(character):
        chosen = shape.vertices[np.unique((shape.vertices @ directions.T).argmax(0))]
        owners += [character.joint_names.index(shape.joint)] * len(chosen)
        points.append(chosen)
    order = np.argsort(owners, kind="stable")
    return np.array(owners)[order], torch.from_numpy(np.concatenate(points)[order])
