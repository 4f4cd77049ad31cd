"""A character's parts of a task: derived fields, actuation, falling, the end of its motion.

Shapes of fields depend on the character. What a class says that it provides are names; the shapes are
those of the instance.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy.task import Actuation, Context, Fields, Shape, box
from understudy_characters.layout import Layout
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_characters.state import character_state
from understudy_characters.surface import Surface, lowest_points, surface_of

__all__ = ["REACH", "Fall", "Reference"]


class Kinematics(Fields):
    """Where the links are and how they move; frames and units in
    :func:`~understudy_characters.state.character_state`."""

    reads = ("qpos", "xpos", "xmat", "xipos", "cvel", "subtree_com")
    provides: Mapping[str, Shape] = {
        "com_position": (3,),
        "root_position": (3,),
        "root_rotation": (4,),
        "root_heading": (),
        "joint_rotations": (0, 4),
        "link_positions": (0, 3),
        "link_rotations": (0, 6),
        "link_linear_velocities": (0, 3),
        "link_angular_velocities": (0, 3),
        "end_effector_positions": (0, 3),
    }

    def __init__(self, options: None, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "fields 'characters/kinematics'").layout
        self._layout = layout.to(context.device)
        self.provides = _sized(self.provides, layout)

    def compute(self, **fields: Tensor) -> Mapping[str, Tensor]:
        return character_state(self._layout, **fields)


class Reference(Fields):
    """The reference motion at each world's time ``motion_start + episode_time``.

    ``reference_link_clearances`` (N, L) m: how high the lowest point of each link is.
    ``motion_ended`` (N,) bool: nothing is left of a motion that does not loop.
    """

    reads = ("motion_start", "episode_time")
    provides: Mapping[str, Shape] = {
        "phase": (),
        "motion_time": (),
        "motion_ended": (),
        "reference_qpos": (0,),
        "reference_qvel": (0,),
        "reference_com_position": (3,),
        "reference_root_position": (3,),
        "reference_root_rotation": (4,),
        "reference_root_heading": (),
        "reference_joint_rotations": (0, 4),
        "reference_end_effector_positions": (0, 3),
        "reference_link_clearances": (0,),
        "reference_joint_targets": (0,),
    }

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "fields 'characters/reference'")
        self._reference = reference_motion(context)
        self.provides = {
            **_sized(self.provides, scene.layout),
            "reference_qpos": (scene.model.nq,),
            "reference_qvel": (scene.model.nv,),
            "reference_link_clearances": (len(scene.layout.link_names),),
            "reference_joint_targets": (scene.layout.num_actuators,),
        }

    def compute(self, motion_start: Tensor, episode_time: Tensor) -> Mapping[str, Tensor]:
        time = motion_start + episode_time
        return {"motion_time": time, **self._reference.sample(time)}


def _sized(names: Mapping[str, Shape], layout: Layout) -> dict[str, Shape]:
    """The shapes of the fields of joints, links and end-effectors, for this character."""
    counts = {
        "joint_rotations": len(layout.joint_names),
        "link_": len(layout.link_names),
        "end_effector_positions": len(layout.end_effectors),
    }
    sized = dict(names)
    for name, shape in names.items():
        for part, count in counts.items():
            if name.removeprefix("reference_").startswith(part):
                sized[name] = (count, *shape[1:])
    return sized


#: rad from the reference's joint targets that learners of actions in [-1, 1] span.
REACH = 0.3


class JointTargets(Actuation):
    """The action is the target of every servo: angles of hinges, exponential maps of balls, in rad.

    Learners of actions in [-1, 1] span :data:`REACH` around the reference's targets, or without a
    reference motion the joints' ranges.
    """

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "actuation 'characters/joint_targets'")
        if "motion" in context.sections:
            self.action_space = box(scene.layout.num_actuators, REACH, "reference_joint_targets")
        else:
            middle, half = joint_ranges(scene.model)
            self.action_space = box(scene.layout.num_actuators, half, middle)

    def control(self, action: Tensor) -> Tensor:
        return action


def joint_ranges(model: mujoco.MjModel) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Middle and half width of what each actuator's joint can do, (U,) rad; a turn where nothing limits
    it, and for each axis of a ball its largest angle either way."""
    joints = model.actuator_trnid[:, 0]
    low, high = model.jnt_range[joints].T.copy()
    low = np.where(model.jnt_type[joints] == mujoco.mjtJoint.mjJNT_BALL, -high, low)
    free = model.jnt_limited[joints] == 0
    low, high = np.where(free, -np.pi, low), np.where(free, np.pi, high)
    return tuple(((low + high) / 2).tolist()), tuple(((high - low) / 2).tolist())


class _UprightLinks:
    """The links that should stay off the floor, and how high they are."""

    def __init__(self, bodies: Sequence[str], context: Context, who: str) -> None:
        scene = context.need_scene(CharacterScene, who)
        layout = scene.layout
        for name in bodies:
            if name not in layout.link_names:
                raise ConfigError(f"{who}: no body '{name}'.{suggestion(name, layout.link_names)}")
        surface = surface_of(scene.character, bodies or layout.upright, layout)
        self._bodies = layout.link_bodies[surface.links].to(context.device)
        self._surface: Surface = surface.to(context.device)
        self.rows = self._surface.links  #: (B,) rows among the links

    def clearances(self, xpos: Tensor, xmat: Tensor) -> Tensor:
        """(N, B) m."""
        position, matrix = (value.index_select(1, self._bodies) for value in (xpos, xmat))
        return lowest_points(self._surface, position[..., 2], matrix[..., 6:])


class FloorContact:
    """A body that should stay up touches the floor: its lowest point is at `clearance` m or below."""

    @dataclass(frozen=True)
    class Options:
        bodies: tuple[str, ...] = ()  #: empty takes root, trunk and head
        clearance: float = 0.0  #: m above the floor that count as touching

        def __post_init__(self) -> None:
            check_range(self, "clearance", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._upright = _UprightLinks(options.bodies, context, "characters/floor_contact")
        self._clearance = options.clearance

    def __call__(self, xpos: Tensor, xmat: Tensor) -> Tensor:
        return (self._upright.clearances(xpos, xmat) <= self._clearance).any(dim=1)


class Fall:
    """A body that should stay up touches the floor, and not because the motion has it there.

    "No undesired contacts" (thesis, eq. 3.3), where the clip says which ones are desired: in a roll
    the back and the head come down to the floor, in a cartwheel the head comes near it, and that is no
    fall. So a body's contact counts only while the reference has the same body higher than `margin` m.
    The margin is the size of the bound on the centre of mass (section 3.5.1): a character that is
    within its bounds may be so much lower than the reference, or as much as this corresponds to early
    or late.
    """

    @dataclass(frozen=True)
    class Options:
        bodies: tuple[str, ...] = ()  #: empty takes root, trunk and head
        clearance: float = 0.0  #: m; touching is being as low as this
        margin: float = 0.2  #: m, from 0: no fall while the reference has the body as low as this (bound of section 3.5.1)

        def __post_init__(self) -> None:
            check_range(self, "margin", least=0, most=1e3)
            check_range(self, "clearance", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._upright = _UprightLinks(options.bodies, context, "characters/fall")
        self._clearance, self._margin = options.clearance, options.margin

    def __call__(self, xpos: Tensor, xmat: Tensor, reference_link_clearances: Tensor) -> Tensor:
        touches = self._upright.clearances(xpos, xmat) <= self._clearance
        meant = reference_link_clearances.index_select(1, self._upright.rows) <= self._margin
        return (touches & ~meant).any(dim=1)

    def used(self, xpos: Tensor, xmat: Tensor, reference_link_clearances: Tensor) -> Tensor:
        """(N, B): of the reference's height above touching, how much each body has lost."""
        reference = reference_link_clearances.index_select(1, self._upright.rows)
        left = self._upright.clearances(xpos, xmat) - self._clearance
        whole = (reference - self._clearance).clamp(min=1e-3)
        return torch.where(reference > self._margin, 1.0 - left / whole, 0.0).clamp(min=0.0)


def motion_end(motion_ended: Tensor) -> Tensor:
    """The motion is over (thesis, section 3.4.2); to be used with ``outcome: truncation``. Never, if it
    loops."""
    return motion_ended
