"""The humanoid's parts of a task: derived fields, actuation, falling."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.task import Actuation, Context, Fields, Shape, box
from understudy_humanoid.kinematics import ground_clearance, kinematics
from understudy_humanoid.scene import HumanoidScene, reference_motion

LINKS, JOINTS, END_EFFECTORS, ACTUATORS = 15, 12, 4, 28


class Kinematics(Fields):
    """Where the links are and how they move; frames and units in :func:`kinematics`."""

    reads = ("qpos", "xpos", "xquat", "cvel", "subtree_com")
    provides: Mapping[str, Shape] = {
        "com_position": (3,),
        "root_position": (3,),
        "root_rotation": (4,),
        "root_heading": (),
        "joint_rotations": (JOINTS, 4),
        "link_positions": (LINKS, 3),
        "link_rotations": (LINKS, 6),
        "link_linear_velocities": (LINKS, 3),
        "link_angular_velocities": (LINKS, 3),
        "end_effector_positions": (END_EFFECTORS, 3),
    }

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(HumanoidScene, "fields 'humanoid.kinematics'")
        self._layout = scene.layout.to(context.device)

    def compute(self, **fields: Tensor) -> Mapping[str, Tensor]:
        return kinematics(self._layout, **fields)


class Reference(Fields):
    """The reference motion at each world's time ``motion_start + episode_time``."""

    reads = ("motion_start", "episode_time")
    provides: Mapping[str, Shape] = {
        "phase": (),
        "motion_time": (),
        "reference_qpos": (43,),
        "reference_com_position": (3,),
        "reference_root_position": (3,),
        "reference_root_rotation": (4,),
        "reference_root_heading": (),
        "reference_joint_rotations": (JOINTS, 4),
        "reference_end_effector_positions": (END_EFFECTORS, 3),
        "reference_joint_targets": (ACTUATORS,),
    }

    def __init__(self, options: None, context: Context) -> None:
        self._reference = reference_motion(context)

    def compute(self, motion_start: Tensor, episode_time: Tensor) -> Mapping[str, Tensor]:
        time = motion_start + episode_time
        return {"motion_time": time, **self._reference.sample(time)}


class JointTargets(Actuation):
    """The action is the PD target of every joint: exponential maps and angles in rad, (N, 28)."""

    action_space = box(ACTUATORS)

    def __init__(self, options: None, context: Context) -> None:
        context.need_scene(HumanoidScene, "actuation 'humanoid.joint_targets'")

    def control(self, action: Tensor) -> Tensor:
        return action


class Fall:
    """A body that should stay up touches the floor (lowest point at or below `clearance` m)."""

    @dataclass(frozen=True)
    class Options:
        bodies: tuple[str, ...] = ("root", "chest", "neck")
        clearance: float = 0.0

    def __init__(self, options: Options, context: Context) -> None:
        layout = context.need_scene(HumanoidScene, "humanoid.fall").layout.to(context.device)
        for name in options.bodies:
            if name not in layout.link_names:
                raise ConfigError(
                    f"humanoid.fall: no body '{name}'.{suggestion(name, layout.link_names)}"
                )
        self._layout, self._clearance = layout, options.clearance
        self._rows = torch.tensor(
            [layout.link_names.index(name) for name in options.bodies], device=context.device
        )

    def __call__(self, xpos: Tensor, xquat: Tensor) -> Tensor:
        lowest = ground_clearance(self._layout, xpos, xquat)[:, self._rows]
        return (lowest <= self._clearance).any(dim=1)
