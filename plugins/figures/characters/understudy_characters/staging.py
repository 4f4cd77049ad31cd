"""The stage of a character: floor, light and sky, contacts, solver settings."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import mujoco
import numpy as np

from understudy_characters.character import Character
from understudy_mujoco.drawing import HORIZON, gradient_sky

__all__ = ["add_floor", "add_sky", "add_sun", "make_solid", "solve_fast", "stage"]

#: Bits of contact masks: what the figure touches, and the figure.
_FLOOR, _FIGURE = 1, 2


#: m: floors so near z = 0 are left where they are.
_LEVEL = 0.005
_UPRIGHT = 0.999
"""The z of the normal of what is level."""


def stage(spec: mujoco.MjSpec, character: Character) -> None:
    """Add to `spec`, from which `character` was compiled, what it lacks: a floor, lights that follow the root, a sky. A
    level floor of its own is moved to z = 0, with everything but the character."""
    geoms = {geom.id: geom for geom in spec.geoms}
    floors = _floors(character)
    solid = [(i, top) for i, top in floors if geoms[i].contype or geoms[i].conaffinity]
    for i, _ in floors if not solid else ():  # only seen so far
        geoms[i].contype, geoms[i].conaffinity = _FLOOR, _FLOOR | _FIGURE
    level = [top for _, top in solid or floors if top is not None]
    if not floors:
        add_floor(spec)
    elif level and abs(max(level)) > _LEVEL:
        _lower(spec, character, max(level))
    if not spec.lights:
        add_sun(spec, character.joint_names[0])
    if not any(t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in spec.textures):
        add_sky(spec)
    spec.visual.global_.offwidth = max(1280, spec.visual.global_.offwidth)
    spec.visual.global_.offheight = max(720, spec.visual.global_.offheight)


def _floors(character: Character) -> list[tuple[int, float | None]]:
    """The geoms that the character can stand on, with the height of their tops in m (None if it varies): those that are
    fixed in the world, below the root, and a plane, a height field, or as wide as the character is long."""
    model, data = character.model, character.zero_pose
    root, reach, found = data.xpos[character.root], 0.5 * character.length, []
    for geom in range(model.ngeom):
        body = int(model.geom_bodyid[geom])
        if body in character.carrier or model.body_weldid[body] != 0:
            continue
        kind, turn = int(model.geom_type[geom]), data.geom_xmat[geom].reshape(3, 3)
        if kind == mujoco.mjtGeom.mjGEOM_HFIELD:
            found.append((geom, None))
        elif kind == mujoco.mjtGeom.mjGEOM_PLANE:
            if turn[2, 2] > 0.5:  # else a wall
                level = turn[2, 2] > _UPRIGHT
                found.append((geom, float(data.geom_xpos[geom, 2]) if level else None))
        else:
            centre = data.geom_xpos[geom] + turn @ model.geom_aabb[geom, :3]
            half = np.abs(turn) @ model.geom_aabb[geom, 3:]
            top, wide = float(centre[2] + half[2]), (half[:2] >= reach).all()
            if wide and (np.abs(root - centre)[:2] <= half[:2]).all() and top <= root[2]:
                found.append((geom, top))
    return found


def _lower(spec: mujoco.MjSpec, character: Character, height: float) -> None:
    """Lower everything but the character by `height` m; the character, too, where it is in one <frame> with others."""
    down = np.array([0.0, 0.0, height])
    for frame in spec.worldbody.frames:
        if frame.frame is None:  # what is in it moves with it
            frame.pos = frame.pos - down
    for geom in spec.worldbody.geoms:
        if geom.frame is not None:
            continue
        if np.isfinite(geom.fromto).all():
            geom.fromto = geom.fromto - np.tile(down, 2)
        else:
            geom.pos = geom.pos - down
    for body in spec.worldbody.bodies:
        if body.id != character.root and body.frame is None:
            body.pos = body.pos - down


def free_name(wanted: str, items: Iterable[Any]) -> str:
    """`wanted`, with a number if one of these `items` of a model has that name."""
    taken = {item.name for item in items}
    names = (wanted, *(f"{wanted}_{k}" for k in range(2, len(taken) + 3)))
    return next(name for name in names if name not in taken)


def add_floor(spec: mujoco.MjSpec) -> None:
    """An infinite chequered floor at z = 0, ``floor`` unless the model has a geom of that name."""
    texture = free_name("floor", spec.textures)
    spec.add_texture(
        name=texture,
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.78, 0.8, 0.83],
        rgb2=[0.72, 0.745, 0.78],
        width=256,
        height=256,
    )
    material = spec.add_material(name=free_name("floor", spec.materials))
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = texture
    material.texrepeat = [1.0, 1.0]
    material.texuniform = True
    floor = spec.worldbody.add_geom(
        name=free_name("floor", spec.geoms),
        type=mujoco.mjtGeom.mjGEOM_PLANE,
        size=[0, 0, 1],
        material=material.name,
    )
    floor.contype, floor.conaffinity, floor.condim = _FLOOR, _FIGURE, 3
    floor.friction = [1.0, 0.005, 0.0001]


def add_sky(spec: mujoco.MjSpec) -> None:
    """A bright sky, and light from everywhere."""
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.45, 0.45, 0.45]
    gradient_sky(spec, free_name("sky", spec.textures))
    spec.visual.rgba.haze = [*HORIZON, 1.0]  # the floor fades into the sky


def add_sun(spec: mujoco.MjSpec, root: str) -> None:
    """Sunlight that follows the body `root`, so that the figure always casts its shadow."""
    spec.body(root).add_light(
        name="sun",
        type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
        mode=mujoco.mjtCamLight.mjCAMLIGHT_TRACK,
        pos=[-1.6, -2.4, 4],
        dir=[0.4, 0.6, -1],
        diffuse=[0.6, 0.6, 0.6],
        castshadow=True,
    )
    # The shadow map covers this box around the light; the light goes where the character goes.
    spec.stat.center, spec.stat.extent = [0, 0, 1], 3
    spec.visual.map.shadowclip = 1.0
    spec.visual.quality.shadowsize = 1024  # drawn without a graphics card, more takes long


def collide(spec: mujoco.MjSpec, figure: set[int], self_collision: bool) -> None:
    """Let the geoms of the bodies `figure` (ids of the compiled `spec`) that collide at all collide with everything else,
    and on request with one another. If none of them collides, those will that are named in a pair, or else all."""
    own = [geom for body in spec.bodies if body.id in figure for geom in body.geoms]
    colliding = [geom for geom in own if geom.contype or geom.conaffinity]
    named = {name for pair in spec.pairs for name in (pair.geomname1, pair.geomname2)}
    paired = [geom for geom in own if geom.name in named]
    for geom in colliding or paired or own:
        geom.contype = _FIGURE
        geom.conaffinity = _FLOOR | (_FIGURE if self_collision else 0)
    for body in spec.bodies:
        if body.id not in figure:
            for geom in body.geoms:
                if geom.contype or geom.conaffinity:
                    geom.contype, geom.conaffinity = _FLOOR, _FLOOR | _FIGURE


def make_solid(geom: mujoco.MjsGeom) -> None:
    """Let a geom of the surroundings collide with figures, and with nothing else."""
    geom.contype, geom.conaffinity = 0, _FIGURE


def solve_fast(option: mujoco.MjOption) -> None:
    """Solver settings with which a figure on a floor is stepped fast, at 600 Hz or so."""
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.iterations, option.ls_iterations = 6, 8
