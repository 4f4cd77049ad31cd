"""Pictures of particles, tools and a table, with MuJoCo's renderer."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any

import mujoco
import numpy as np

from understudy_mujoco.drawing import open_renderer
from understudy_pbd.scene import Box, Capsule, Grid, ParticleModel, Shape, TaperedCapsule

__all__ = ["add_geom", "draw", "particle_colours"]

#: Colours of materials without colours of their own: rice, butter, honey, broth.
_PALETTE = np.array(
    [[0.93, 0.87, 0.73], [0.96, 0.80, 0.38], [0.85, 0.52, 0.20], [0.42, 0.66, 0.78]]
)
_TOOL = np.array([0.45, 0.50, 0.56, 1.0])
_WORLD = """
<mujoco>
  <visual>
    <headlight ambient="0.35 0.35 0.36" diffuse="0.25 0.25 0.25" specular="0 0 0"/>
    <quality shadowsize="4096" offsamples="4"/>
    <global offwidth="{width}" offheight="{height}"/>
  </visual>
  <asset>
    <texture name="sky" type="skybox" builtin="gradient" rgb1="0.93 0.94 0.95" rgb2="0.72 0.78 0.84" width="64" height="64"/>
    <texture name="table" type="2d" builtin="checker" rgb1="0.60 0.47 0.36" rgb2="0.57 0.44 0.33" width="256" height="256"/>
    <material name="table" texture="table" texrepeat="1 1" texuniform="true"/>
  </asset>
  <worldbody>
    <light pos="0 0 {high}" dir="0.3 0.4 -1" directional="true" diffuse="0.7 0.69 0.66"/>
    {table}
  </worldbody>
</mujoco>
"""


def draw(
    model: ParticleModel,
    tracks: Mapping[str, np.ndarray],
    width: int,
    height: int,
    azimuth: float | None = None,
) -> Iterator[np.ndarray]:
    """Frames (height, width, 3) uint8 of the recorded ``particle_position`` (T, P, 3), and of tools
    and ``active_particles`` where they are recorded.

    Raises
    ------
    UnderstudyError
        if there is no OpenGL to draw with.
    """
    positions = tracks["particle_position"]
    count = len(model.positions)
    radius = np.broadcast_to(np.asarray(model.radius, float), count)
    colours = particle_colours(model, count)
    low, high = _mostly_within(positions, tracks.get("tool_position"))
    centre, size = 0.5 * (low + high), float(np.linalg.norm(high - low)) + 8 * float(radius.max())
    table = f'<geom type="plane" size="0 0 {0.5 * size}" material="table"/>' if model.table else ""
    world = _WORLD.format(width=width, height=height, high=10 * size, table=table)
    compiled = mujoco.MjModel.from_xml_string(world)
    compiled.stat.extent, compiled.stat.center[:] = size, centre
    shapes = [(number, shape) for number, tool in enumerate(model.tools) for shape in tool.shapes]
    data = mujoco.MjData(compiled)
    mujoco.mj_forward(compiled, data)
    renderer = open_renderer(compiled, width, height, count + len(shapes) + 16)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = centre
    camera.distance, camera.elevation, camera.azimuth = 0.95 * size, -28.0, 130.0
    camera.azimuth = camera.azimuth if azimuth is None else azimuth
    try:
        for frame, here in enumerate(positions):
            renderer.update_scene(data, camera)
            drawn = renderer.scene
            there = tracks["active_particles"][frame] if "active_particles" in tracks else None
            for i in range(count):
                if there is None or there[i]:
                    sphere = (float(radius[i]), 0.0, 0.0)
                    kind = mujoco.mjtGeom.mjGEOM_SPHERE
                    add_geom(drawn, kind, sphere, here[i], np.eye(3), colours[i])
            if "tool_position" in tracks and "tool_orientation" in tracks:
                at = tracks["tool_position"][frame].reshape(-1, 3)
                turned = tracks["tool_orientation"][frame].reshape(-1, 4)
                for layer, (number, shape) in enumerate(shapes):
                    inner = layer / len(shapes)
                    _add_shape(drawn, inner, shape, at[number], turned[number])
            yield renderer.render()
    finally:
        renderer.close()


def _mostly_within(*places: np.ndarray | None) -> np.ndarray:
    """The corners (2, 3) of the box in which most of each of the `places` (T, …), world frame, m, ever
    are: what the camera looks at."""
    found = [np.quantile(p.reshape(-1, 3), (0.02, 0.98), axis=0) for p in places if p is not None]
    return np.stack([np.min(found, axis=(0, 1)), np.max(found, axis=(0, 1))])


def particle_colours(model: ParticleModel, count: int) -> np.ndarray:
    """(P, 4); a little lighter and darker from particle to particle, so that one sees grains."""
    if model.colours is not None:
        rgb = np.asarray(model.colours, float)
    else:
        material = np.broadcast_to(np.asarray(model.material), count)
        rgb = _PALETTE[material % len(_PALETTE)]
    shade = 0.9 + 0.16 * ((np.arange(count) * 0.6180339887) % 1.0)
    return np.concatenate([np.clip(rgb * shade[:, None], 0, 1), np.ones((count, 1))], axis=1)


def _add_shape(drawn: Any, inner: float, shape: Shape, at: np.ndarray, turned: np.ndarray) -> None:
    """Boxes of a tool may share a side: those with more `inner`, below 1, are a little smaller, so that
    one of them is in front."""
    tool = _matrix(turned)
    if isinstance(shape, Grid):  # the points just inside its surface, as small boxes
        inside = np.argwhere(np.abs(shape.distances) <= 0.5 * shape.spacing)
        half = (0.5 * shape.spacing,) * 3
        for index in inside:
            point = at + tool @ (np.asarray(shape.origin) + index * shape.spacing)
            add_geom(drawn, mujoco.mjtGeom.mjGEOM_BOX, half, point, tool, _TOOL)
        return
    point, turn = at + tool @ np.asarray(shape.position), tool @ _matrix(shape.orientation)
    if isinstance(shape, Box):
        half = np.array(shape.half_extents)
        half -= 0.2 * inner * half.min()
        add_geom(drawn, mujoco.mjtGeom.mjGEOM_BOX, half, point, turn, _TOOL)
    elif isinstance(shape, Capsule):
        size = (shape.radius, shape.half_length, shape.half_length)
        add_geom(drawn, mujoco.mjtGeom.mjGEOM_CAPSULE, size, point, turn, _TOOL)
    elif isinstance(shape, TaperedCapsule):  # as spheres side by side
        for share in np.linspace(0, 1, 12):
            radius = (1 - share) * shape.radii[0] + share * shape.radii[1]
            along = point + (2 * share - 1) * shape.half_length * turn[:, 2]
            add_geom(drawn, mujoco.mjtGeom.mjGEOM_SPHERE, (radius, 0, 0), along, turn, _TOOL)


def add_geom(
    drawn: Any, kind: Any, size: Any, at: np.ndarray, turn: np.ndarray, colour: np.ndarray
) -> None:
    """One more geom of the scene, while there is room."""
    if drawn.ngeom >= drawn.maxgeom:
        return
    geom = drawn.geoms[drawn.ngeom]
    mujoco.mjv_initGeom(
        geom,
        kind,
        np.asarray(size, float),
        np.asarray(at, float),
        np.asarray(turn, float).reshape(-1),
        np.asarray(colour, np.float32),
    )
    geom.category = mujoco.mjtCatBit.mjCAT_DYNAMIC
    geom.specular, geom.shininess = 0.2, 0.4
    drawn.ngeom += 1


def _matrix(wxyz: Any) -> np.ndarray:
    w, x, y, z = np.asarray(wxyz, float) / np.linalg.norm(wxyz)
    return np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - w * z), 2 * (x * z + w * y)],
            [2 * (x * y + w * z), 1 - 2 * (x * x + z * z), 2 * (y * z - w * x)],
            [2 * (x * z - w * y), 2 * (y * z + w * x), 1 - 2 * (x * x + y * y)],
        ]
    )
