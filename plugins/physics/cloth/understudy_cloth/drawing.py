"""Pictures of cloth and of the bodies that it meets, with MuJoCo's renderer."""

from __future__ import annotations

import itertools
from collections.abc import Callable, Iterator, Mapping, Sequence

import mujoco
import numpy as np
import torch
from scipy.ndimage import gaussian_filter1d

from understudy_cloth.scene import Box, Capsule, ClothModel, TaperedCapsule
from understudy_mujoco.drawing import open_renderer
from understudy_tensors import rotations

_BODY, _CLOTH = (0.85, 0.62, 0.45, 1.0), (0.35, 0.55, 0.78, 1.0)
_FLOOR, _SQUARES = (0.90, 0.90, 0.89), (0.80, 0.82, 0.84)
#: Pieces of a tapered capsule, which MuJoCo has not: capsules whose radii follow it.
_PIECES = 12
#: Times its own size: what moves about within that is seen from where it is seen whole; else the camera follows it,
#: over so many frames smoothed.
_STAYS, _SMOOTHING = 2.0, 6.0


def _spec(model: ClothModel, width: int, height: int, floor: float | None = None) -> mujoco.MjSpec:
    """A mocap body for each tool, and the garment as a flex of the world; a floor of the height `floor`, m."""
    spec = mujoco.MjSpec()
    spec.visual.global_.offwidth, spec.visual.global_.offheight = width, height
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.4] * 3, [0.45] * 3
    spec.visual.headlight.specular = [0.05] * 3
    spec.visual.quality.offsamples = 4
    spec.add_texture(
        name="sky", type=mujoco.mjtTexture.mjTEXTURE_SKYBOX, width=64, height=64,
        builtin=mujoco.mjtBuiltin.mjBUILTIN_GRADIENT, rgb1=[0.95, 0.96, 0.97], rgb2=[0.78, 0.82, 0.87],
    )  # fmt: skip
    light = spec.worldbody.add_light(pos=[2, -2, 4], dir=[-0.4, 0.4, -1], diffuse=[0.4, 0.4, 0.4])
    if floor is not None:  # on which one walks away from a lamp
        light.type = mujoco.mjtLightType.mjLIGHT_DIRECTIONAL
    for number, tool in enumerate(model.tools):
        body = spec.worldbody.add_body(name=f"tool{number}", mocap=True)
        for shape in tool.shapes:
            if isinstance(shape, Box):
                body.add_geom(type=mujoco.mjtGeom.mjGEOM_BOX, size=shape.half_extents, rgba=_BODY,
                              pos=shape.position, quat=shape.orientation)  # fmt: skip
                continue
            if not isinstance(shape, (Capsule, TaperedCapsule)):
                continue  # a grid of distances has no surface to draw
            radii = shape.radii if isinstance(shape, TaperedCapsule) else (shape.radius,) * 2
            turn = np.zeros(9)
            mujoco.mju_quat2Mat(turn, np.asarray(shape.orientation, float))
            axis = turn.reshape(3, 3)[:, 2]
            ends = np.linspace(-shape.half_length, shape.half_length, _PIECES + 1)
            for low, high in itertools.pairwise(ends):
                share = (0.5 * (low + high) + shape.half_length) / max(2 * shape.half_length, 1e-9)
                a, b = (np.asarray(shape.position) + axis * end for end in (low, high))
                radius = radii[0] + share * (radii[1] - radii[0])
                if high - low < 1e-9:
                    body.add_geom(
                        type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[radius, 0, 0], pos=a, rgba=_BODY
                    )
                    break
                body.add_geom(type=mujoco.mjtGeom.mjGEOM_CAPSULE, size=[radius, 0, 0],
                              fromto=[*a, *b], rgba=_BODY)  # fmt: skip
    if floor is not None:
        spec.add_texture(
            name="squares", type=mujoco.mjtTexture.mjTEXTURE_2D, width=256, height=256,
            builtin=mujoco.mjtBuiltin.mjBUILTIN_CHECKER, rgb1=_FLOOR, rgb2=_SQUARES,
        )  # fmt: skip
        squares = spec.add_material(name="squares", texrepeat=[1, 1], texuniform=True)
        squares.textures[mujoco.mjtTextureRole.mjTEXROLE_RGB] = "squares"
        spec.worldbody.add_geom(type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05],
                                pos=[0, 0, floor], material="squares")  # fmt: skip
    flex = spec.add_flex(name="cloth", dim=2, radius=1e-3, rgba=_CLOTH, flatskin=False)
    flex.vertbody = ["world"]
    flex.vert = np.asarray(model.positions, float).ravel()
    flex.elem = np.asarray(model.faces, np.int32).ravel()
    flex.contype = flex.conaffinity = 0
    return spec


def _path(seen: Sequence[np.ndarray], frames: int) -> tuple[np.ndarray, float]:
    """Where in each of the frames the middle of everything is, smoothed, (T, 3) m, and how large a ball around it has all, m across."""
    points = np.concatenate([them.reshape(frames, -1, 3) for them in seen], axis=1)
    low, high = points.min(axis=1), points.max(axis=1)
    smooth = gaussian_filter1d(0.5 * (low + high), _SMOOTHING, axis=0, mode="nearest")
    return smooth, 2.0 * float(np.linalg.norm(points - smooth[:, None], axis=2).max())


def _corners(compiled: mujoco.MjModel, tracks: Mapping[str, np.ndarray]) -> np.ndarray:
    """Between which the tools' geoms are in each of T frames: corners of boxes around them, (2 T G, 3) m."""
    geoms = np.flatnonzero(compiled.geom_bodyid > 0)
    tool = compiled.body_mocapid[compiled.geom_bodyid[geoms]]
    frames = len(tracks["tool_position"])
    turn = tracks["tool_orientation"].reshape(frames, -1, 4)[:, tool]
    turned = rotations.rotate(
        torch.as_tensor(turn).double(), torch.tensor(compiled.geom_pos[geoms])
    ).numpy()
    at = tracks["tool_position"].reshape(frames, -1, 3)[:, tool] + turned
    reach = compiled.geom_rbound[geoms, None]
    return np.concatenate([at - reach, at + reach], axis=1).reshape(-1, 3)


def draw(
    model: ClothModel,
    tracks: Mapping[str, np.ndarray],
    width: int,
    height: int,
    azimuth: float | None = None,
    more: Callable[[int, mujoco.MjvScene], None] | None = None,
    floor: float | None = None,
) -> Iterator[np.ndarray]:
    """Frames (height, width, 3) uint8 of the recorded ``cloth_position`` (T, V, 3), and of tools where they are
    recorded. `more` is told the frame's number and adds shapes to its picture; a `floor` is that many m high.

    Raises
    ------
    UnderstudyError
        if there is no OpenGL to draw with.
    """
    cloth = tracks["cloth_position"]
    compiled = _spec(model, width, height, floor).compile()
    data = mujoco.MjData(compiled)
    seen = [cloth.reshape(-1, 3)]
    low, high = np.quantile(seen[0], (0.01, 0.99), axis=0)
    moved = bool(model.tools) and {"tool_position", "tool_orientation"} <= tracks.keys()
    if moved and len(tools := _corners(compiled, tracks)):
        seen.append(tools)
        low, high = np.minimum(low, tools.min(axis=0)), np.maximum(high, tools.max(axis=0))
    middle, size = _path(seen, len(cloth))
    room = float(np.linalg.norm(high - low))
    if room < _STAYS * size:
        middle[:], size = 0.5 * (low + high), room
    compiled.stat.extent, compiled.stat.center[:] = size, 0.5 * (low + high)
    camera = mujoco.MjvCamera()
    camera.distance, camera.elevation = 1.3 * size, -15.0
    camera.azimuth = 130.0 if azimuth is None else azimuth
    renderer = open_renderer(compiled, width, height, compiled.ngeom + 64)
    option = mujoco.MjvOption()
    option.flags[mujoco.mjtVisFlag.mjVIS_FLEXSKIN] = True
    try:
        for frame, here in enumerate(cloth):
            if moved:
                data.mocap_pos[:] = tracks["tool_position"][frame].reshape(-1, 3)
                data.mocap_quat[:] = tracks["tool_orientation"][frame].reshape(-1, 4)
            mujoco.mj_kinematics(compiled, data)
            mujoco.mj_camlight(compiled, data)
            mujoco.mj_flex(compiled, data)
            data.flexvert_xpos[:] = here
            camera.lookat[:] = middle[frame]
            renderer.update_scene(data, camera, option)
            if more is not None:
                more(frame, renderer.scene)
            yield renderer.render()
    finally:
        renderer.close()
