"""Servo targets that stay near what a person's joints can do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy.options import as_yaml
from understudy.task import Actuation, Context, box
from understudy_characters.scene import CharacterScene
from understudy_characters.target_limits import Range, check_axes, servo_axes, target_limits
from understudy_tensors.limits import ANGLE, check_angle, in_degrees

#: rad, of the right side: about the axes forward, left and up of the zero pose for balls. Ours, from
#: tables of the ranges of motion of athletes; the left side mirrors the first and the last axis.
RANGES: dict[str, tuple[Range, ...]] = {
    "chest": ((-0.5, 0.5), (-0.6, 0.8), (-0.6, 0.6)),
    "neck": ((-0.5, 0.5), (-0.7, 0.6), (-0.7, 0.7)),
    "right_hip": ((-0.9, 0.4), (-2.0, 0.6), (-0.5, 0.5)),
    "right_knee": ((0.0, 2.5),),
    "right_ankle": ((-0.3, 0.3), (-0.5, 0.8), (-0.3, 0.3)),
    "right_shoulder": ((-2.6, 0.4), (-2.9, 1.0), (-1.0, 1.0)),
    "right_elbow": ((0.0, 2.5),),
}


class Targets(Actuation):
    """The action, from the pose `rest` on, is the target of every servo, cut to the joints' `ranges`
    and `margin` beyond, and to the control ranges of the model's servos.

    Within the margin a servo still gives its whole torque at the end of the range. The rest is where
    exploration begins: a swing leg that is not bent there stamps on the ground at once.
    """

    @dataclass(frozen=True)
    class Options:
        #: By joint, rad, in place of a person's: (least, most) of each axis, no margin added.
        ranges: Mapping[str, tuple[Range, ...]] = field(default_factory=dict)
        margin: float = 0.5  #: rad, from 0, that targets may lie beyond a joint's range
        #: rad, targets of joints for an action of 0, by joint; 0 where none is given
        rest: Mapping[str, tuple[float, ...]] = field(default_factory=dict)

        def __post_init__(self) -> None:
            check_angle(self, "margin", least=0)
            for joint, angles in self.rest.items():
                if (far := max(map(abs, angles), default=0.0)) > ANGLE[1]:
                    raise ValueError(
                        f"rest.{joint}={as_yaml(angles)} is not possible: {in_degrees(far)}"
                    )

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "actuation 'jumping/targets'")
        joints = scene.layout.joint_names
        for name in options.rest:
            if name not in joints:
                raise ConfigError(
                    f"actuation.rest: there is no joint '{name}'.{suggestion(name, joints)}"
                )
            check_axes(f"actuation.rest.{name}", len(options.rest[name]), name, scene.model)
        known: dict[str, tuple[Range, ...]] = {
            name: tuple((low - options.margin, high + options.margin) for low, high in ranges)
            for name, ranges in (RANGES | _left(RANGES)).items()
            if name in joints
        }
        ranges = {**known, **options.ranges}
        for (
            name,
            angles,
        ) in options.rest.items():  # what a model's own servos cannot do holds a joint on purpose
            for angle, (low, high) in zip(angles, ranges.get(name, ()), strict=False):
                if not low <= angle <= high:
                    raise ConfigError(
                        f"actuation.rest.{name}={as_yaml(angles)} is not possible: {angle:g} rad is beyond the range of its "
                        f"targets, {low:.4g} to {high:.4g}. Give less, or a wider one in actuation.ranges."
                    )
        self._low, self._high = target_limits(scene, ranges, context.device, torch.pi)
        rest = [
            (*options.rest.get(name, ()), 0.0, 0.0, 0.0)[axis]
            for name, axis in servo_axes(scene.model)
        ]
        self._rest = torch.tensor(rest, device=context.device)
        self.action_space = box(len(rest))

    def control(self, action: Tensor) -> Tensor:
        return (self._rest + action).clamp(self._low, self._high)


def _left(right: Mapping[str, tuple[Range, ...]]) -> dict[str, tuple[Range, ...]]:
    """The ranges of the left side."""
    mirrored: dict[str, tuple[Range, ...]] = {}
    for name, ranges in right.items():
        if name.startswith("right_"):
            other = ranges
            if len(ranges) == 3:
                (a, b), middle, (c, d) = ranges
                other = ((-b, -a), middle, (-d, -c))
            mirrored[name.replace("right_", "left_")] = other
    return mirrored
