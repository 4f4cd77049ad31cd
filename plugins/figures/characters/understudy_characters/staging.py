"""What a character stands on and is seen by: floor, light and sky, contacts, solver settings."""

from __future__ import annotations

import mujoco

#: Bits of contact masks: what the figure touches, and the figure.
_FLOOR, _FIGURE = 1, 2


def stage(spec: mujoco.MjSpec, root: str) -> None:
    """Add to the model what it has not got of a floor, lights that follow the body `root`, a sky."""
    kinds = {int(geom.type) for geom in spec.worldbody.geoms}
    if not kinds & {int(mujoco.mjtGeom.mjGEOM_PLANE), int(mujoco.mjtGeom.mjGEOM_HFIELD)}:
        add_floor(spec)
    if not spec.lights:
        add_sun(spec, root)
    if not any(t.type == mujoco.mjtTexture.mjTEXTURE_SKYBOX for t in spec.textures):
        add_sky(spec)
    spec.visual.global_.offwidth = max(1280, spec.visual.global_.offwidth)
    spec.visual.global_.offheight = max(720, spec.visual.global_.offheight)


def add_floor(spec: mujoco.MjSpec) -> None:
    """An infinite chequered floor at z = 0."""
    spec.add_texture(
        name="floor",
        type=mujoco.mjtTexture.mjTEXTURE_2D,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER,
        rgb1=[0.78, 0.8, 0.83],
        rgb2=[0.72, 0.745, 0.78],
        width=256,
        height=256,
    )
    material = spec.add_material(name="floor")
    material.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "floor"
    material.texrepeat = [1.0, 1.0]
    material.texuniform = True
    floor = spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 1], material="floor"
    )
    floor.contype, floor.conaffinity, floor.condim = _FLOOR, _FIGURE, 3
    floor.friction = [1.0, 0.005, 0.0001]


def add_sky(spec: mujoco.MjSpec) -> None:
    """A bright sky, and light from everywhere."""
    spec.visual.headlight.ambient = [0.35, 0.35, 0.35]
    spec.visual.headlight.diffuse = [0.45, 0.45, 0.45]
    spec.add_texture(
        name="sky",
        type=mujoco.mjtTexture.mjTEXTURE_SKYBOX,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT,
        rgb1=[0.93, 0.95, 0.98],
        rgb2=[0.62, 0.7, 0.8],
        width=256,
        height=1536,
    )
    spec.visual.rgba.haze = [0.93, 0.95, 0.98, 1.0]  # the floor fades into the sky


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
    """Let the geoms of the bodies `figure` (ids of the compiled `spec`) that collide at all collide with
    everything else, and with one another on request. If none of them does, all will."""
    own = [geom for body in spec.bodies if body.id in figure for geom in body.geoms]
    colliding = [geom for geom in own if geom.contype or geom.conaffinity]
    for geom in colliding or own:
        geom.contype = _FIGURE
        geom.conaffinity = _FLOOR | (_FIGURE if self_collision else 0)
    for body in spec.bodies:
        if body.id not in figure:
            for geom in body.geoms:
                if geom.contype or geom.conaffinity:
                    geom.contype, geom.conaffinity = _FLOOR, _FLOOR | _FIGURE


def make_solid(geom: mujoco.MjsGeom) -> None:
    """Let a geom that stands around collide with figures, and with nothing else."""
    geom.contype, geom.conaffinity = 0, _FIGURE


def solve_fast(option: mujoco.MjOption) -> None:
    """Solver settings with which a figure on a floor is stepped fast, at 600 Hz or so."""
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.solver = mujoco.mjtSolver.mjSOL_NEWTON
    option.cone = mujoco.mjtCone.mjCONE_PYRAMIDAL
    option.iterations, option.ls_iterations = 6, 8
