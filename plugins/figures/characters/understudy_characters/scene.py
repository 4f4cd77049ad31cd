"""A character on its floor, as a scene; and the reference motion that its tasks share."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Literal

import mujoco
import numpy as np
from scipy.ndimage import gaussian_filter1d

from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_characters import staging
from understudy_characters.character import Character, character_spec
from understudy_characters.heads import head_body, ring
from understudy_characters.layout import Layout, layout_of
from understudy_characters.reference import ReferenceMotion
from understudy_characters.servos import (
    COARSE_SPEED,
    ServoOptions,
    drive,
    gains_of,
    warn_of_shaking,
)
from understudy_characters.shapes import body_shapes
from understudy_characters.state import Poses
from understudy_characters.surroundings import Surroundings
from understudy_motion.section import Motion
from understudy_motion.writing import Shape
from understudy_mujoco.contact import Contact
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco.scenery import Camera
from understudy_mujoco.studio import LEARNED, REFERENCE, Figure
from understudy_mujoco.studio import draw as draw_figures

__all__ = ["CharacterScene", "other_bodies", "reference_motion"]

#: In lengths of the figure: how far to the left the reference is drawn.
_BESIDE = 0.74
#: The camera's distance, in heights of what it shows; and the frames over which its path is smoothed.
_DISTANCE, _SMOOTHING = 1.75, 6.0


@dataclass(frozen=True)
class Thing:
    """A body around the character, and where it is in T frames."""

    name: str
    positions: np.ndarray  #: (T, 3) m, world
    rotations: np.ndarray  #: (T, 4), world
    shapes: list[Shape]  #: in its frame


def other_bodies(character: Character, qpos: np.ndarray) -> Iterator[Thing]:
    """The other bodies with geoms of the character's model, the world's included, moved by `qpos`, (T, nq); without
    planes, which are infinite, and mocap bodies, whose places are not in `qpos`."""
    model, data = character.model, mujoco.MjData(character.model)
    solid = model.geom_bodyid[model.geom_type != mujoco.mjtGeom.mjGEOM_PLANE]
    drawn = {int(body) for body in solid if model.body_mocapid[body] < 0}
    bodies = sorted(drawn - set(character.carrier))

    def arrange(frame: int) -> None:
        data.qpos[:] = qpos[frame]

    return _things(character, data, bodies, len(qpos), arrange)


def _things(
    character: Character,
    data: mujoco.MjData,
    bodies: Sequence[int],
    frames: int,
    arrange: Callable[[int], None],
) -> Iterator[Thing]:
    """Those of the `bodies` that have a surface, in their size of the first frame; `arrange` puts the `data` of the
    character's model into the state of a frame."""
    surfaces: list[list[Shape]] = []
    poses = []
    for frame in range(frames):
        arrange(frame)
        mujoco.mj_kinematics(character.model, data)
        poses.append((data.xpos[bodies].copy(), data.xquat[bodies].copy()))
        surfaces = surfaces or [body_shapes(character, body) for body in bodies]
    for row, surface in enumerate(surfaces):
        if surface:
            positions, turns = (np.array([pose[k][row] for pose in poses]) for k in (0, 1))
            yield Thing(surface[0].joint, positions, turns, surface)


_FLAGS = {
    "contact": mujoco.mjtDisableBit.mjDSBL_CONTACT,
    "constraint": mujoco.mjtDisableBit.mjDSBL_CONSTRAINT,
    "actuation": mujoco.mjtDisableBit.mjDSBL_ACTUATION,
}
_VERTICAL = 0.9
"""The z of an axis whose heading is none."""
_TIES = (int(mujoco.mjtEq.mjEQ_CONNECT), int(mujoco.mjtEq.mjEQ_WELD))


def _refuse_what_is_off(name: str, spec: mujoco.MjSpec) -> None:
    """Raise ConfigError for a model that switches off what a character needs to stand and move, as display models do."""
    option = spec.option
    off = [f'<flag {flag}="disable"/>' for flag, bit in _FLAGS.items() if option.disableflags & bit]
    if any(option.disableactuator >> one.group & 1 for one in spec.actuators):
        off.append("actuatorgroupdisable=…")
    if off:
        raise ConfigError(
            f"Model '{name}' switches off what a character stands and moves by: {', '.join(off)}. Take that out of its "
            "<option>."
        )


def _warn_of_ties(name: str, character: Character) -> None:
    """Warn if the figure is tied to the world, as in a gantry: it cannot fall."""
    model, own = character.model, set(character.carrier)
    for k in range(model.neq):
        if model.eq_type[k] not in _TIES:
            continue
        pair = [int(model.eq_obj1id[k]), int(model.eq_obj2id[k])]
        if model.eq_objtype[k] == int(mujoco.mjtObj.mjOBJ_SITE):
            pair = [int(model.site_bodyid[site]) for site in pair]
        held = [model.body_weldid[body] == 0 or model.body_mocapid[body] >= 0 for body in pair]
        if model.eq_active0[k] and any(held) and not own.isdisjoint(pair):
            body = next(model.body(one).name for one in pair if one in own)
            warnings.warn(
                f"Model '{name}' ties its body '{body}' to the world (<equality>), so it cannot fall or leave that place; "
                "take the tie out of the file if it should.",
                stacklevel=3,
            )


def _warn_of_heading(name: str, character: Character) -> None:
    """Warn if the root's x axis, whose heading is the figure's, is vertical in the zero pose."""
    forward = character.zero_pose.xmat[character.root].reshape(3, 3)[:, 0]
    if abs(forward[2]) > _VERTICAL:
        warnings.warn(
            f"Model '{name}': the x axis of its root '{character.joint_names[0]}' is vertical in the zero pose, so which way "
            "the figure heads, by which much is observed and rewarded, cannot be told from it. Turn the frame of that body, "
            "so that x is ahead.",
            stacklevel=3,
        )


class CharacterScene(MujocoScene):
    """One character on a floor, each of its joints driven by a position servo, and what the config
    sections that are :class:`Surroundings` put around it."""

    @dataclass(frozen=True)
    class Options:
        character: str  #: name of a registered character, or path of an MJCF file
        self_collision: bool = False  #: whether the character's links collide with one another
        #: ``fast``: implicit integration, few Newton iterations; ``model``: what the model says.
        solver: Literal["fast", "model"] = "fast"
        end_effectors: tuple[str, ...] = ()  #: bodies that are hands and feet; empty finds them
        #: how servos are made where the model has none
        servos: ServoOptions = field(default_factory=ServoOptions)
        contact: Contact = field(default_factory=Contact)  #: how contacts are solved

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self._options, self.contact = options, options.contact
        registry = context.registry if context and context.registry else installed().registry
        name, spec = character_spec(options.character, registry, context)
        timestep = context.control_dt / context.substeps if context else 1 / 600
        character = _compiled(name, spec, options.character)
        if len(character.joints) == 1:
            raise ConfigError(
                f"Model '{name}' is no character: nothing hangs on its free body "
                f"'{character.joint_names[0]}' by a joint."
            )
        if character.company:
            others = ", ".join(
                f"'{first}' ({n} joint{'s' * (n > 1)})" for first, n in character.company.items()
            )
            warnings.warn(
                f"Model '{name}' has more on joints than the character '{character.joint_names[0]}': {others}. "
                "It stays in the scene and nothing steers it; take it out of the file if it should not be there.",
                stacklevel=2,
            )
        servos = options.servos
        own = (context and context.own_substeps) or 0  # of the task; a training may begin coarser
        if context and context.substeps < own and servos.step_speed is None:
            servos = replace(servos, step_speed=COARSE_SPEED)
        # A finer step tries the same model, so that is made for the task's step, or a longer one.
        longest = (
            context.control_dt / min(context.substeps, own or context.substeps)
            if context
            else timestep
        )
        drive(spec, character, timestep, servos, longest)
        _refuse_what_is_off(name, spec)
        _warn_of_ties(name, character)
        _warn_of_heading(name, character)
        spec.modelname = name
        spec.option.timestep = timestep
        if options.solver == "fast":
            staging.solve_fast(spec.option)
        staging.collide(spec, set(character.carrier), options.self_collision)
        root = next(body for body in spec.bodies if body.id == character.root)
        root.name = character.joint_names[0]
        staging.stage(spec, character)
        sections = context.sections.values() if context else ()
        self._around = tuple(s for s in sections if isinstance(s, Surroundings))
        self.recorded = ("qpos", "reference_qpos", "phase")
        own = {body.name for body in spec.bodies}
        for one in self._around:
            try:
                one.add(spec)
            except ValueError as error:
                reason = str(error).strip().splitlines()[0].removeprefix("Error: ")
                raise FileError(
                    f"What stands around the character cannot be added to the model of {name}: "
                    f"{reason}. Rename what the model calls so."
                ) from error
            self.recorded += one.recorded
        self._things = [body.name for body in spec.bodies if body.name not in own]
        self._spec = spec
        self.character = _compiled(name, self.spec(), options.character)
        warn_of_shaking(self.character, timestep)

    def spec(self) -> mujoco.MjSpec:
        spec = self._spec.copy()
        spec.compiler.discardvisual = True
        return spec

    def shown(self) -> mujoco.MjSpec:
        return self._spec.copy()

    @cached_property
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
        """The recorded motion in the character's colours; or, if there is a reference, in blue, with the reference beside it in
        orange."""
        track, reference = tracks["qpos"], tracks.get("reference_qpos")
        at, length = self.layout.root_address, self.character.length

        def place(model: mujoco.MjModel, data: mujoco.MjData, frame: int) -> None:
            self._arrange(model, data, tracks, frame)

        figures, beside = [Figure(track, place=place)], 0.0
        if reference is not None:
            beside = _BESIDE * length
            figures = [
                Figure(track, LEARNED, label="learned", place=place),
                Figure(reference, REFERENCE, (0.0, beside), "reference"),
            ]
        heights = np.concatenate([self._sticks(figure.track)[..., 2].ravel() for figure in figures])
        top = float(np.clip(np.nan_to_num(heights).max(), length, 3.0 * length))
        camera = Camera(
            aims=np.array([0.0, 0.5 * beside])
            + gaussian_filter1d(track[:, at : at + 2], _SMOOTHING, axis=0, mode="nearest"),
            height=0.45 * top,
            distance=_DISTANCE * top,
        )
        if self.azimuth is not None:
            camera = replace(camera, azimuth=self.azimuth)
        return draw_figures(self.shown().compile(), figures, camera, width, height)

    def surroundings(self, tracks: Mapping[str, np.ndarray]) -> Iterator[Thing]:
        """The surroundings of the character in the recorded `tracks`, each (T, …), in their size of the first frame."""
        character = Character(self.character.name, self.shown().compile())
        model, data = character.model, mujoco.MjData(character.model)
        bodies = [model.body(name).id for name in self._things]
        frames = len(tracks["qpos"]) if bodies else 0
        return _things(
            character, data, bodies, frames, lambda k: self._arrange(model, data, tracks, k)
        )

    def _arrange(
        self,
        model: mujoco.MjModel,
        data: mujoco.MjData,
        tracks: Mapping[str, np.ndarray],
        frame: int,
    ) -> None:
        """Put what stands around the character where it was in a `frame` of the recorded `tracks`."""
        try:
            seen = {name: recorded[frame] for name, recorded in tracks.items()}
            for one in self._around:
                one.place(model, data, seen)
        except (LookupError, TypeError, ValueError) as error:
            raise FileError(
                "The recording does not say where what stands around the character is "
                f"({type(error).__name__}: {error}); make another with `understudy render RUN`."
            ) from error

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        reference = tracks.get("reference_qpos")
        return self._sticks(tracks["qpos"]), None if reference is None else self._sticks(reference)

    def _sticks(self, track: np.ndarray) -> np.ndarray:
        """(T, S, 2, 3): a segment from each link's parent to the link, and a ring as its head; m, world."""
        model, data = self.model, mujoco.MjData(self.model)
        links = np.array([b for b in self.character.carrier if b != self.character.root])
        ends = np.stack([model.body_parentid[links], links], axis=1)
        head = head_body(self.character)
        result, tops = [], []
        for qpos in track:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            result.append(data.xpos[ends])
            tops.append(data.xipos[head or 0].copy())
        sticks = np.array(result)
        if head is None:
            return sticks
        return np.concatenate([sticks, ring(np.array(tops), self.character.length)], axis=1)

    def describe(self) -> dict[str, Any]:
        return {
            **super().describe(),
            "character": self.character.name,
            "end_effectors": list(self.layout.end_effectors),
            "self_collision": self._options.self_collision,
            "servos": gains_of(self.spec().compile()),
        }


def _compiled(name: str, spec: mujoco.MjSpec, named: str) -> Character:
    try:
        return Character(name, spec.compile(), named)
    except (ValueError, mujoco.FatalError) as error:
        reason = str(error).strip().splitlines()[0]
        raise FileError(f"The model of {name} does not compile: {reason}") from error


def reference_motion(context: Context) -> ReferenceMotion:
    """The task's reference motion, built once from the config section ``motion``.

    Raises
    ------
    ConfigError
        its clip is shorter than a control period.
    """
    scene = context.need_scene(CharacterScene, "the reference motion")
    motion = context.need_section("motion", Motion, "the reference motion")
    clip, period = motion.clip, context.control_dt
    if clip.duration < period - 1e-9:
        raise ConfigError(
            f"Clip {clip.name} lasts {clip.duration:.3g} s, less than a control period ({period:.3g} s), so nothing of it is "
            "seen. Take a longer one, see whether its frame rate is right, or raise control.frequency."
        )
    return context.once(
        "reference_motion",
        lambda: ReferenceMotion(
            motion.clip,
            scene.character,
            scene.layout,
            control_dt=context.control_dt,
            device=context.device,
            floor=motion.floor,
        ),
    )
