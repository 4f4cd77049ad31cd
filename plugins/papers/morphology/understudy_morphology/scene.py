"""The walker as a scene: its model, where its links are in MuJoCo's arrays, and how it is drawn."""

from __future__ import annotations

from collections.abc import Iterator, Mapping

import mujoco
import numpy as np

from understudy.task import Context
from understudy_characters.staging import add_sky, add_sun
from understudy_morphology.figure import ROOT, TIMESTEP, Scales, build_spec, standing_height
from understudy_mujoco.drawing import draw_motion
from understudy_mujoco.scene import MujocoScene

#: Of the qpos and qvel of the free root, which come first.
ROOT_POSITIONS, ROOT_VELOCITIES = 7, 6


class WalkerScene(MujocoScene):
    """The walker of the given scales on a floor."""

    recorded = ("qpos",)
    Options = Scales

    def __init__(self, options: Scales, context: Context | None = None) -> None:
        self.scales = options
        self.standing_height = standing_height(options)  #: m
        self._timestep = context.control_dt / context.substeps if context else TIMESTEP

    def spec(self) -> mujoco.MjSpec:
        return build_spec(self.scales, self._timestep)

    def shown(self) -> mujoco.MjSpec:
        spec = self.spec()
        add_sky(spec)
        add_sun(spec, ROOT)
        spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 720
        return spec

    @property
    def joints(self) -> int:
        """J, the number of hinges."""
        return self.model.nv - ROOT_VELOCITIES

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """The recorded motion from the side, with a camera that goes along."""
        camera = mujoco.MjvCamera()
        camera.distance, camera.elevation = 2.9 * self.standing_height, -8.0
        camera.azimuth = 115.0 if self.azimuth is None else self.azimuth

        def follow(frame: int, data: mujoco.MjData) -> None:
            camera.lookat = [data.qpos[0], data.qpos[1], 0.85 * self.standing_height]

        model = self.shown().compile()
        yield from draw_motion(model, tracks["qpos"], (width, height), camera, follow)

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """A segment from each link's parent's joint to its own."""
        data, links = mujoco.MjData(self.model), np.arange(2, self.model.nbody)
        ends = np.stack([self.model.body_parentid[links], links], axis=1)
        segments = []
        for qpos in tracks["qpos"]:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(self.model, data)
            segments.append(data.xpos[ends])
        return np.array(segments), None
