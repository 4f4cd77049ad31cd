"""A character on its floor, as a scene; and the reference motion that its tasks share."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, Literal

import mujoco
import numpy as np

from understudy.errors import FileError, UnderstudyError
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_characters import staging
from understudy_characters.character import Character, character_spec
from understudy_characters.layout import Layout, layout_of
from understudy_characters.reference import ReferenceMotion
from understudy_characters.servos import ServoOptions, drive, gains_of
from understudy_characters.state import Poses
from understudy_motion.section import Motion
from understudy_mujoco.scene import MujocoScene

REFERENCE_COLOUR = (0.45, 0.72, 0.5, 1.0)
#: In lengths of the figure: how far to the left the reference is drawn; the camera's distance and aim.
_BESIDE, _DISTANCE, _AIM = 0.74, 2.4, 0.52


class CharacterScene(MujocoScene):
    """One character on a floor, each of its joints driven by a position servo."""

    recorded = ("qpos", "reference_qpos", "phase")

    @dataclass(frozen=True)
    class Options:
        character: str  #: name of a registered character, or path of an MJCF file
        self_collision: bool = False  #: whether the character's links collide with one another
        #: ``fast``: implicit integration, few Newton iterations; ``model``: what the model says.
        solver: Literal["fast", "model"] = "fast"
        end_effectors: tuple[str, ...] = ()  #: bodies that are hands and feet; empty finds them
        servos: ServoOptions = field(default_factory=ServoOptions)

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self._options = options
        name, spec = character_spec(options.character, installed().registry)
        timestep = context.control_dt / context.substeps if context else 1 / 600
        character = _compiled(name, spec)
        drive(spec, character, timestep, options.servos)
        spec.modelname = name
        spec.option.timestep = timestep
        if options.solver == "fast":
            staging.solve_fast(spec.option)
        staging.collide(spec, set(character.carrier), options.self_collision)
        root = next(body for body in spec.bodies if body.id == character.root)
        root.name = character.joint_names[0]
        staging.stage(spec, root.name)
        self._spec = spec
        self.character = _compiled(name, self.spec())

    def spec(self) -> mujoco.MjSpec:
        spec = self._spec.copy()
        spec.compiler.discardvisual = True
        return spec

    def shown(self) -> mujoco.MjSpec:
        return self._spec.copy()

    @property
    def model(self) -> mujoco.MjModel:
        return self.character.model

    @cached_property
    def layout(self) -> Layout:
        return layout_of(self.character, self._options.end_effectors)

    @cached_property
    def poses(self) -> Poses:
        return Poses(self.character, self.layout)

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """The recorded motion in the character's colours, its reference beside it in green."""
        model = self.shown().compile()
        own, reference = mujoco.MjData(model), mujoco.MjData(model)
        try:
            renderer = mujoco.Renderer(model, height, width)
        except Exception as error:  # whatever the platform's OpenGL raises
            reason = str(error).strip().splitlines()
            raise UnderstudyError(f"No OpenGL here ({reason[0] if reason else error}).") from error
        at, length = self.layout.root_address, self.character.length
        references = tracks.get("reference_qpos")
        beside = 0.0 if references is None else _BESIDE * length
        camera = mujoco.MjvCamera()
        camera.distance, camera.elevation, camera.azimuth = _DISTANCE * length, -10.0, 120.0
        camera.azimuth = camera.azimuth if self.azimuth is None else self.azimuth
        first = True
        try:
            for frame, qpos in enumerate(tracks["qpos"]):
                own.qpos[:] = qpos
                mujoco.mj_kinematics(model, own)
                mujoco.mj_camlight(model, own)
                aim = np.array([qpos[at], qpos[at + 1] + 0.5 * beside, _AIM * length])
                camera.lookat = aim if first else camera.lookat + 0.2 * (aim - camera.lookat)
                first = False
                renderer.update_scene(own, camera)
                if references is not None:
                    reference.qpos[:] = references[frame]
                    reference.qpos[at + 1] += beside
                    add_figure(renderer.scene, model, reference)
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
        links = np.array([b for b in self.character.carrier if b != self.character.root])
        ends = np.stack([model.body_parentid[links], links], axis=1)
        result = []
        for qpos in track:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            result.append(data.xpos[ends])
        return np.array(result)

    def describe(self) -> dict[str, Any]:
        return {
            **super().describe(),
            "character": self.character.name,
            "end_effectors": list(self.layout.end_effectors),
            "self_collision": self._options.self_collision,
            "servos": gains_of(self.spec().compile()),
        }


def _compiled(name: str, spec: mujoco.MjSpec) -> Character:
    try:
        return Character(name, spec.compile())
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).strip().splitlines()[0]
        raise FileError(f"The model of {name} does not compile: {reason}") from error


def add_figure(scene: mujoco.MjvScene, model: mujoco.MjModel, data: mujoco.MjData) -> None:
    """Show what moves once more, as `data` has it, in the reference's colour."""
    mujoco.mj_kinematics(model, data)
    before = scene.ngeom
    every = int(mujoco.mjtCatBit.mjCAT_DYNAMIC)
    mujoco.mjv_addGeoms(model, data, mujoco.MjvOption(), mujoco.MjvPerturb(), every, scene)
    for geom in scene.geoms[before : scene.ngeom]:
        geom.matid = -1
        geom.rgba[:] = REFERENCE_COLOUR


def reference_motion(context: Context) -> ReferenceMotion:
    """The task's reference motion, built once from the config section ``motion``."""
    scene = context.need_scene(CharacterScene, "the reference motion")
    motion = context.need_section("motion", Motion, "the reference motion")
    return context.once(
        "reference_motion",
        lambda: ReferenceMotion(
            motion.clip,
            scene.character,
            scene.layout,
            control_dt=context.control_dt,
            device=context.device,
        ),
    )
