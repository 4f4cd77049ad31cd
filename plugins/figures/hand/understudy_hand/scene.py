"""A hand on an arm, with a tool, at a table, as a scene."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

import mujoco
import numpy as np

from understudy.options import check_range
from understudy.task import Context
from understudy_hand import tools
from understudy_hand.model import build_spec
from understudy_hand.robot import Robot, robot_links
from understudy_hand.table import Link, Measures, links
from understudy_mujoco.contact import Contact
from understudy_mujoco.drawing import draw_motion, gradient_sky
from understudy_mujoco.scene import MujocoScene

__all__ = ["HandScene"]

#: Firm contacts, and the integrator under which stiff servos bear them; measured at 5 ms.
FIRM = Contact(
    integrator="discrete",
    cone="elliptic",
    impratio=100.0,
    iterations=20,
    ls_iterations=20,
    solref=(0.01, 1.0),
    solimp=(0.99, 0.99, 0.01),
)
#: m from the palm, in sizes of the hand; degrees.
_DISTANCE, _AZIMUTH, _ELEVATION = 0.45, 345.0, -14.0
#: m, in the palm's frame.
_AIM = np.array([0.02, -0.06, 0.09])
#: m, in the world, and m from there: where an object is moved.
_TABLE_AIM, _TABLE_DISTANCE = np.array([0.0, -0.05, 0.06]), 0.62
_GHOST = np.array([0.145, 0.388, 0.922, 0.35], np.float32)


class HandScene(MujocoScene):
    """A hand on an arm whose shoulder stands, holding a tool over a table; each hinge has a position
    servo. The tool's bodies come after the hand's."""

    @dataclass(frozen=True)
    class Options:
        fingers: int = 5  #: how many there are, from the thumb on: 3 to 5
        finger_length: float = 1.0  #: of all fingers, in those of the human hand
        size: float = 1.0  #: of the hand, in that of the human hand; the arm stays as it is
        tool: tools.Tool = "sticks"  #: what the hand holds
        object: tools.Thing | None = None  #: what lies on the table; null is nothing
        #: what it is put upon, free to move, too; null is the table
        below: tools.Thing | None = None
        above: tools.Thing | None = None  #: what lies upon it and is to go along; null is nothing
        friction: float = 1.0  #: sliding, of everything (the release)
        #: how contacts are solved, where not FIRM
        contact: Contact = field(default_factory=Contact)
        #: whether links of different fingers touch one another; not so in the release
        self_collision: bool = False
        #: another hand than the human one, of a package that is installed
        robot: Robot | None = None

        def __post_init__(self) -> None:
            measures = Measures(self.fingers, self.finger_length, self.size)
            if self.robot is not None and measures != Measures():
                raise ValueError(
                    "robot is a hand of its own: leave out fingers, finger_length and size."
                )
            check_range(self, "friction", above=0)
            for name in ("below", "above"):
                if (lying := getattr(self, name)) is not None and lying.kind == "any":
                    raise ValueError(
                        f"{name}.kind=any is not possible: worlds differ in the object alone (object.kind=any)."
                    )

    #: ``planned_upper`` and ``planned_lower``, positions and rotations (7,) in the palm's frame, are drawn
    #: as a ghost, and so is ``planned_object`` (7,), in the world.
    recorded = ("qpos", "planned_upper", "planned_lower", "planned_object")

    def __init__(self, options: Options, context: Context | None = None) -> None:
        self.options, self.contact = options, options.contact
        self.measures = Measures(options.fingers, options.finger_length, options.size)
        #: What the object may be, where worlds differ in it.
        self.forms = options.object.forms if options.object is not None else None
        if self.forms is not None:
            self.recorded = (*self.recorded, *self.forms.varies)
        self.timestep = context.control_dt / context.substeps if context else 0.005

    def spec(self) -> mujoco.MjSpec:
        spec = build_spec(
            self._links, self.measures.names, self.options.tool, self.options.friction,
            self.options.object, self.options.below, self.options.above, self.options.self_collision,
        )  # fmt: skip
        spec.option.timestep = self.timestep
        FIRM.apply(spec)
        self.contact.apply(spec)
        return spec

    def shown(self) -> mujoco.MjSpec:
        spec = self.spec()
        spec.visual.headlight.ambient = [0.4, 0.4, 0.4]
        spec.visual.headlight.diffuse = [0.35, 0.35, 0.35]
        spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 720
        spec.visual.map.znear = 0.005
        spec.stat.extent, spec.stat.center = 1.0, [0, 0, 0.2]
        spec.visual.quality.shadowsize = 2048
        spec.worldbody.add_light(
            type=mujoco.mjtLightType.mjLIGHT_DIRECTIONAL,
            pos=[-0.6, -0.9, 1.6],
            dir=[0.4, 0.6, -1],
            diffuse=[0.55, 0.55, 0.55],
            castshadow=True,
        )
        gradient_sky(spec)
        return spec

    def look(self, model: mujoco.MjModel, tracks: Mapping[str, np.ndarray], frame: int) -> None:
        if self.forms is not None:
            self.forms.show(model, tracks, frame)

    @cached_property
    def _links(self) -> tuple[Link, ...]:
        robot = self.options.robot
        return links(self.measures) if robot is None else robot_links(robot)

    @property
    def links(self) -> tuple[str, ...]:
        """Names of the bodies of arm and hand, parents first."""
        return tuple(link.name for link in self._links)

    @property
    def robot(self) -> str:
        """Of what model the hand is; empty is the human one of the table."""
        return self.options.robot.name if self.options.robot is not None else ""

    @property
    def hinges(self) -> int:
        """H, of arm and hand; they come first in qpos and qvel."""
        return self.model.nu

    @property
    def tool_bodies(self) -> tuple[str, ...]:
        """The upper part first; empty without a tool."""
        return tools.BODIES[self.options.tool]

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """A close-up of the hand; what is planned, where it is, as a ghost."""
        model = self.shown().compile()
        camera = mujoco.MjvCamera()
        camera.distance, camera.elevation = _DISTANCE * max(1.0, self.measures.size), _ELEVATION
        camera.azimuth = _AZIMUTH if self.azimuth is None else self.azimuth
        palm = model.body("palm").id

        def aim(frame: int, data: mujoco.MjData) -> None:
            self.look(model, tracks, frame)
            if frame == 0:  # it stands still: the hand's movement is what is to be seen
                turn = data.xmat[palm].reshape(3, 3)
                camera.lookat = data.xpos[palm] + turn @ (self.measures.size * _AIM)
                if self.options.object is not None:  # which is to be seen, and where it goes
                    camera.lookat, camera.distance = _TABLE_AIM, _TABLE_DISTANCE

        def ghosts(frame: int, data: mujoco.MjData, scene: mujoco.MjvScene) -> None:
            for name in ("planned_upper", "planned_lower"):
                if name in tracks:
                    turn = data.xmat[palm].reshape(3, 3)
                    _add_ghost(scene, data.xpos[palm], turn, tracks[name][frame])
            if "planned_object" in tracks and self.options.object is not None:
                _add_object(scene, model, tracks["planned_object"][frame])

        yield from draw_motion(model, tracks["qpos"], (width, height), camera, aim, ghosts)

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """(T, S, 2, 3): a segment from each link's parent to the link, and one along each part of the
        tool."""
        model, data = self.model, mujoco.MjData(self.model)
        own = np.array([model.body(name).id for name in self.links])
        ends = np.stack([model.body_parentid[own], own], axis=1)
        parts = [model.body(name).id for name in self.tool_bodies]
        along = np.array([[-tools.HALF_LENGTH, 0, 0], [tools.HALF_LENGTH, 0, 0]])
        segments = []
        for qpos in tracks["qpos"]:
            data.qpos[:] = qpos
            mujoco.mj_kinematics(model, data)
            sticks = [data.xpos[b] + along @ data.xmat[b].reshape(3, 3).T for b in parts]
            segments.append(np.concatenate([data.xpos[ends], np.reshape(sticks, (-1, 2, 3))]))
        return np.array(segments), None

    def describe(self) -> dict[str, Any]:
        return {
            **super().describe(),
            "fingers": list(self.measures.names),
            "tool": self.options.tool,
        }


def _add_ghost(
    scene: mujoco.MjvScene, palm: np.ndarray, turn: np.ndarray, pose: np.ndarray
) -> None:
    """A translucent stick at `pose` (7,) in the frame of the palm, which is at `palm` (3,), `turn` (3, 3)."""
    if scene.ngeom >= scene.maxgeom:
        return
    rotation = np.zeros(9)
    mujoco.mju_quat2Mat(rotation, np.asarray(pose[3:], np.float64))
    axis = rotation.reshape(3, 3)[:, 0]
    ends = [
        palm + turn @ (np.asarray(pose[:3]) + way * tools.HALF_LENGTH * axis) for way in (-1, 1)
    ]
    geom = scene.geoms[scene.ngeom]
    capsule = mujoco.mjtGeom.mjGEOM_CAPSULE
    mujoco.mjv_initGeom(geom, capsule, np.zeros(3), np.zeros(3), np.zeros(9), _GHOST)
    mujoco.mjv_connector(geom, capsule, 1.02 * tools.RADIUS, *ends)
    scene.ngeom += 1


def _add_object(scene: mujoco.MjvScene, model: mujoco.MjModel, pose: np.ndarray) -> None:
    """The object, translucent, at `pose` (7,) in the world."""
    if scene.ngeom >= scene.maxgeom:
        return
    own = np.flatnonzero(model.geom_bodyid == model.body("object").id)
    number = own[model.geom_rgba[own, 3] > 0][0]  # of its forms the one that is seen
    turn, matrix = np.zeros(4), np.zeros(9)
    mujoco.mju_mulQuat(turn, np.asarray(pose[3:], np.float64), model.geom_quat[number])
    mujoco.mju_quat2Mat(matrix, turn)
    geom = scene.geoms[scene.ngeom]
    size = 1.02 * model.geom_size[number]
    if model.geom_type[number] == mujoco.mjtGeom.mjGEOM_SPHERE:
        size = np.full(3, size[0])
    elif model.geom_type[number] == mujoco.mjtGeom.mjGEOM_CAPSULE:
        size = np.array([size[0], size[0], size[1]])
    place = np.asarray(pose[:3], np.float64)
    mujoco.mjv_initGeom(geom, int(model.geom_type[number]), size, place, matrix, _GHOST)
    scene.ngeom += 1
