"""Pictures of a figure at a table with the tool in its hand and the run's particles."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from understudy_amorphous.character import TABLE, Figure, Placement
from understudy_mujoco.drawing import open_renderer
from understudy_pbd.drawing import add_geom, particle_colours
from understudy_pbd.scene import ParticleModel

_GOAL = np.array([0.85, 0.15, 0.12, 1.0])
#: degrees: from the figure's front, to its left, from above
_AZIMUTH, _ELEVATION = 218.0, -24.0


def draw(
    figure: Figure,
    qpos: np.ndarray,
    particles: ParticleModel,
    tracks: Mapping[str, np.ndarray],
    placement: Placement,
    width: int = 960,
    height: int = 540,
) -> Iterator[np.ndarray]:
    """Frames (height, width, 3) uint8 of ``qpos`` (T, nq) and of what the run recorded beside it.

    Raises
    ------
    UnderstudyError
        there is no OpenGL to draw with.
    """
    model, count = figure.model, len(particles.positions)
    data = mujoco.MjData(model)
    radius = placement.scale * np.broadcast_to(np.asarray(particles.radius, float), count)
    colours = particle_colours(particles, count)
    places = placement.points(tracks["particle_position"].astype(float))
    there = tracks.get("active_particles", np.ones(places.shape[:2]))
    goal = tracks.get("goal")
    goals = None if goal is None else placement.points(np.pad(goal.astype(float), ((0, 0), (0, 1))))
    renderer = open_renderer(model, width, height, count + model.ngeom + 64)
    camera = _camera(figure, qpos)
    sphere, upright = mujoco.mjtGeom.mjGEOM_SPHERE, np.eye(3)
    try:
        for frame, pose in enumerate(qpos):
            data.qpos[:] = pose
            mujoco.mj_kinematics(model, data)
            mujoco.mj_camlight(model, data)
            renderer.update_scene(data, camera)
            for i in np.flatnonzero(there[frame]):
                size = (float(radius[i]), 0.0, 0.0)
                add_geom(renderer.scene, sphere, size, places[frame, i], upright, colours[i])
            if goals is not None:
                size = (0.1 * placement.scale, 0.0, 0.0)
                add_geom(renderer.scene, sphere, size, goals[frame], upright, _GOAL)
            yield renderer.render()
    finally:
        renderer.close()


def _camera(figure: Figure, qpos: np.ndarray) -> mujoco.MjvCamera:
    """It sees what moves of the figure, and the table, from the figure's left front."""
    model, data = figure.model, mujoco.MjData(figure.model)
    moving = [geom.id for geom in figure.character.shown if geom.joint != 0]
    mujoco.mj_kinematics(model, data)
    seen = [data.geom_xpos[[model.geom(TABLE).id]].copy()]
    for pose in qpos[:: max(1, len(qpos) // 20)]:
        data.qpos[:] = pose
        mujoco.mj_kinematics(model, data)
        seen.append(data.geom_xpos[moving].copy())
    points = np.concatenate(seen)
    low, high = points.min(axis=0), points.max(axis=0)
    camera = mujoco.MjvCamera()
    camera.lookat[:] = 0.5 * (low + high)
    camera.distance = 1.15 * float(np.linalg.norm(high - low))
    camera.azimuth, camera.elevation = _AZIMUTH, _ELEVATION
    return camera
