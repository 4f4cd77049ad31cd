"""How far the targets of a character's servos may go."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy_characters.scene import CharacterScene
from understudy_tensors.limits import ANGLE, in_degrees

__all__ = ["Range", "check_axes", "servo_axes", "target_limits"]

Range = tuple[float, float]


def servo_axes(model: mujoco.MjModel) -> list[tuple[str, int]]:
    """For each servo: the joint that it drives, by the name of its body, and its axis: the number of the hinge
    among the body's, or the axis of a ball joint."""
    found = []
    for servo in range(model.nu):
        joint = int(model.actuator_trnid[servo, 0])
        body = model.body(int(model.jnt_bodyid[joint]))
        axis = joint - int(model.body_jntadr[body.id])
        if model.jnt_type[joint] == mujoco.mjtJoint.mjJNT_BALL:
            axis = int(np.abs(model.actuator_gear[servo, :3]).argmax())
        found.append((body.name, axis))
    return found


def check_axes(option: str, given: int, joint: str, model: mujoco.MjModel) -> None:
    """Raise ConfigError if an `option` gives a joint more values than its servos have axes."""
    count = sum(name == joint for name, _ in servo_axes(model))
    if given > count:
        raise ConfigError(
            f"{option} is of {given}, but servos turn {joint} about {count}: give as many at most."
        )


def target_limits(
    scene: CharacterScene,
    ranges: Mapping[str, Sequence[Range]],
    device: torch.device,
    otherwise: float = math.inf,
    option: str = "actuation.ranges",
) -> tuple[Tensor, Tensor]:
    """The least and the greatest target of each servo, each (U,) rad: by joint, `ranges` has (least, most) for each
    axis; without it, they are `otherwise` either way. They never exceed a servo's control range in the model.

    Raises
    ------
    ConfigError
        `ranges`, which is the `option` of an actuation, names no joint of the character, has more
        ranges than a joint has servos, a range whose first number is the higher one or that goes beyond a whole turn, or one without any of a servo's.
    """
    joints, model = scene.layout.joint_names, scene.model
    for name, axes in ranges.items():
        if name not in joints:
            raise ConfigError(f"{option}: there is no joint '{name}'.{suggestion(name, joints)}")
        far = max((abs(end) for both in axes for end in both if math.isfinite(end)), default=0.0)
        if far > ANGLE[1]:
            raise ConfigError(f"{option}.{name}={axes} is not possible: {in_degrees(far)}")
        if any(low > high for low, high in axes):
            raise ConfigError(f"{option}.{name}={axes}: the first is the lower one.")
        check_axes(f"{option}.{name}", len(axes), name, model)
    found = []
    for servo, (name, axis) in enumerate(servo_axes(model)):
        axes = ranges.get(name, ())
        low, high = axes[axis] if axis < len(axes) else (-otherwise, otherwise)
        if model.actuator_ctrllimited[servo]:
            least, most = map(float, model.actuator_ctrlrange[servo])
            if low > most or high < least:
                raise ConfigError(
                    f"{option}.{name}: {low:g} to {high:g} rad of axis {axis} is beyond what its servo takes in the model, "
                    f"{least:g} to {most:g}. Give a range that reaches into it."
                )
            low, high = max(low, least), min(high, most)
        found.append((low, high))
    low, high = torch.tensor(found, device=device).unbind(1)
    return low, high
