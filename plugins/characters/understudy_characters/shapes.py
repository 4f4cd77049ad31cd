"""What a character looks like: a triangle mesh of each geom, fixed to the joint that carries it."""

from __future__ import annotations

import mujoco
import numpy as np
import trimesh

from understudy_characters.character import Character
from understudy_motion.writing import Shape


def shapes(character: Character) -> list[Shape]:
    """The geoms of `character` as triangle meshes in the frames of its clips' joints.

    Curved geoms are tessellated, about 300 triangles each. Their colours are the model's.
    """
    model = character.model
    data = mujoco.MjData(model)
    mujoco.mj_kinematics(model, data)
    root = data.xmat[character.root].reshape(3, 3)
    result = []
    for geom in character.geoms:
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
                tuple(float(c) for c in colour),
            )
        )
    return result


def _mesh(character: Character, geom: int) -> trimesh.Trimesh:
    kind, size = int(character.model.geom_type[geom]), character.model.geom_size[geom]
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
