"""What a film shows beside person and garment: where the person feels the garment, and the task vector."""

from __future__ import annotations

from collections.abc import Mapping

import mujoco
import numpy as np

from understudy_dressing.body import radii, sensors, tool_bodies

#: Fields that are recorded for it.
FELT = ("sensor_force", "sensor_sign", "fingertip", "task_vector")
#: Of a sensor that is touched from inside, from outside, and from both as much.
_INSIDE, _OUTSIDE, _BOTH = (0.10, 0.65, 0.25), (0.85, 0.15, 0.10), (0.95, 0.80, 0.10)
_VECTOR = (0.95, 0.75, 0.05, 1.0)
#: N at which a sensor is fully lit; m, the least that it stands out of the skin, and the vector's length and radius.
_FULL, _OUT, _LENGTH, _THICK = 5.0, 0.006, 0.18, 0.006


class Felt:
    """Adds to a picture a sphere around each sensor that is touched, the less transparent the more force there is, green
    from inside and red from outside (equations 4 to 6), and an arrow from the fingertip along the task vector (equation 7)."""

    def __init__(self, tracks: Mapping[str, np.ndarray]) -> None:
        """`tracks` of T frames: ``tool_position`` and ``tool_orientation`` of the person's bodies, and :data:`FELT`."""
        bodies = tool_bodies()
        # the spine has no shape and so no tool; a clavicle turns about the same point
        tools = [
            bodies.index("left_clavicle" if name == "spine" else name) for name, _ in sensors()
        ]
        local = np.array([point for _, point in sensors()], float)
        turn, place = tracks["tool_orientation"][:, tools], tracks["tool_position"][:, tools]
        w, v = turn[..., :1], turn[..., 1:]
        twice = 2.0 * np.cross(v, np.broadcast_to(local, v.shape))
        self._places = place + local + w * twice + np.cross(v, twice)  # (T, S, 3)
        self._force = np.linalg.norm(tracks["sensor_force"], axis=-1)  # (T, S) N
        self._sign, self._radii = tracks["sensor_sign"], radii()
        self._tip, self._vector = tracks["fingertip"], tracks["task_vector"]

    def __call__(self, frame: int, scene: mujoco.MjvScene) -> None:
        for number in np.flatnonzero(self._force[frame] > 0):
            sign, lit = self._sign[frame, number], min(1.0, self._force[frame, number] / _FULL)
            colour = _INSIDE if sign > 0 else _OUTSIDE if sign < 0 else _BOTH
            size = np.full(3, self._radii[number] + _OUT)
            rgba = np.array((*colour, 0.25 + 0.75 * lit), np.float32)
            self._add(scene, mujoco.mjtGeom.mjGEOM_SPHERE, size, self._places[frame, number], rgba)
        begin = np.asarray(self._tip[frame], float)
        end = begin + _LENGTH * self._vector[frame]
        arrow = mujoco.mjtGeom.mjGEOM_ARROW
        geom = self._add(scene, arrow, np.zeros(3), begin, np.array(_VECTOR, np.float32))
        mujoco.mjv_connector(geom, arrow, _THICK, begin, end)

    @staticmethod
    def _add(
        scene: mujoco.MjvScene, kind: mujoco.mjtGeom, size: np.ndarray, place: np.ndarray, rgba: np.ndarray
    ) -> mujoco.MjvGeom:  # fmt: skip
        geom = scene.geoms[scene.ngeom]
        mujoco.mjv_initGeom(geom, kind, size, np.asarray(place, float), np.eye(3).ravel(), rgba)
        scene.ngeom += 1
        return geom
