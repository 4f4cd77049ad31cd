"""The humanoid on its floor, as a scene; and the reference motion that its tasks share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from understudy.errors import UnderstudyError
from understudy.task import Context
from understudy_humanoid.character import (
    REFERENCE_COLOUR,
    add_character,
    add_trunk,
    build_spec,
)
from understudy_humanoid.kinematics import CharacterLayout, character_layout
from understudy_humanoid.reference import ReferenceMotion
from understudy_motion.section import Motion
from understudy_mujoco.scene import MujocoScene

#: Where the reference is drawn, beside the learned motion, in m to the left.
_BESIDE = 1.2


class HumanoidScene(MujocoScene):
    """One 34-DoF humanoid on an infinite floor."""

    recorded = ("qpos", "reference_qpos", "phase")

    @dataclass(frozen=True)
    class Options:
        self_collision: bool = False  #: whether the character's links collide with one another

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self._options = options
        self._timestep = context.control_dt / context.substeps if context else 1 / 600

    def spec(self) -> mujoco.MjSpec:
        return build_spec(timestep=self._timestep, self_collision=self._options.self_collision)

    def shown(self) -> mujoco.MjSpec:
        spec = self.spec()
        add_trunk(spec)
        return spec

    @cached_property
    def model(self) -> mujoco.MjModel:
        return self.spec().compile()

    @cached_property
    def layout(self) -> CharacterLayout:
        return character_layout(self.model)

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """The recorded motion in warm colours, its reference beside it in green."""
        spec = self.shown()
        beside = "reference_qpos" in tracks
        if beside:
            add_character(spec, prefix="reference_", colour=REFERENCE_COLOUR, collides=False)
            add_trunk(spec, prefix="reference_", colour=REFERENCE_COLOUR)
        model = spec.compile()
        data = mujoco.MjData(model)
        try:
            renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # whatever the platform's OpenGL raises
            reason = str(error).strip().splitlines()
            raise UnderstudyError(f"No OpenGL here ({reason[0] if reason else error}).") from error
        camera = mujoco.MjvCamera()
        camera.distance, camera.elevation, camera.azimuth = 3.9, -10.0, 120.0
        own = self.model.nq
        first = True
        try:
            for frame, qpos in enumerate(tracks["qpos"]):
                data.qpos[:own] = qpos
                if beside:
                    data.qpos[own:] = tracks["reference_qpos"][frame]
                    data.qpos[own + 1] += _BESIDE
                mujoco.mj_kinematics(model, data)
                mujoco.mj_camlight(model, data)
                aim = np.array([qpos[0], qpos[1] + (0.5 * _BESIDE if beside else 0.0), 0.85])
                camera.lookat = aim if first else camera.lookat + 0.2 * (aim - camera.lookat)
                first = False
                renderer.update_scene(data, camera)
                yield renderer.render()
        finally:
            renderer.close()

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        reference = tracks.get("reference_qpos")
        return self._sticks(tracks["qpos"]), None if reference is None else self._sticks(reference)

    def _sticks(self, track: np.ndarray) -> np.ndarray:
        """(T, S, 2, 3): a segment from each link's parent to the link, m, world."""
        model, data = self.model, mujoco.MjData(self.model)
        links = np.array([b for b in range(1, model.nbody) if model.body_parentid[b] != 0])
        ends = np.stack([model.body_parentid[links], links], axis=1)
        result = []
        for qpos in track:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            result.append(data.xpos[ends])
        return np.array(result)

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "self_collision": self._options.self_collision}


def reference_motion(context: Context) -> ReferenceMotion:
    """The task's reference motion, built once from the config section ``motion``."""
    scene = context.need_scene(HumanoidScene, "the reference motion")
    motion = context.need_section("motion", Motion, "the reference motion")
    return context.once(
        "reference_motion",
        lambda: ReferenceMotion(
            motion.clip,
            scene.model,
            scene.layout,
            control_dt=context.control_dt,
            device=context.device,
        ),
    )
