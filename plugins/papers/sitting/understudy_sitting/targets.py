"""Where to walk to: targets drawn anew, and those that a controller above gives."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Memory, Shape
from understudy_tensors import rotations


class TargetAhead(Memory):
    """A ``target`` (N, 2), m in the world, drawn in front of the figure every so many seconds or when it
    is reached (section 6). Distance and direction are uniform; the paper gives neither."""

    reads = ("torso_position", "torso_yaw")
    keeps: Mapping[str, Shape] = {"target": (2,), "target_age": ()}
    uniforms = 2

    @dataclass(frozen=True)
    class Options:
        every: float = 2.5  #: s, above 0, after which a new target is drawn
        within: float = 0.3  #: m, distance at which the target is reached
        near: float = 1.5  #: m, above 0, the nearest target
        far: float = 4.0  #: m, the farthest target; above ``near``
        #: degrees, 0 to 180: greatest angle of a target off straight ahead, to each side
        degrees: float = 60.0

        def __post_init__(self) -> None:
            check_range(self, "within", "near", most=1e3)
            check_range(self, "every", "within", "near", above=0)
            check_range(self, "far", least=self.near, most=1e3)
            check_range(self, "degrees", least=0, most=180)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._dt = options, context.control_dt

    def begin(
        self, uniforms: Tensor, torso_position: Tensor, torso_yaw: Tensor
    ) -> dict[str, Tensor]:
        options = self._options
        distance = options.near + (options.far - options.near) * uniforms[:, 0]
        angle = torso_yaw + math.radians(options.degrees) * (2 * uniforms[:, 1] - 1)
        away = distance[:, None] * torch.stack([angle.cos(), angle.sin()], dim=1)
        return {"target": torso_position[:, :2] + away, "target_age": torch.zeros_like(angle)}

    def advance(
        self,
        kept: Mapping[str, Tensor],
        uniforms: Tensor,
        torso_position: Tensor,
        torso_yaw: Tensor,
    ) -> dict[str, Tensor]:
        age = kept["target_age"] + self._dt
        distance = (kept["target"] - torso_position[:, :2]).norm(dim=1)
        again = (age >= self._options.every - 0.5 * self._dt) | (distance <= self._options.within)
        drawn = self.begin(uniforms, torso_position, torso_yaw)
        return {
            "target": torch.where(again[:, None], drawn["target"], kept["target"]),
            "target_age": torch.where(again, 0.0, age),
        }


class TargetByChair(Fields):
    """The ``target`` (N, 2) that the controller above chose, m in the world.

    Its a^target (N, 2) counts from a place ``ahead`` m in front of the seat, in the chair's frame: x ahead
    of the chair, y to its left. So "in front of the chair" is the same action wherever both are.
    """

    reads = ("goal", "chair_position", "chair_rotation")
    provides: Mapping[str, Shape] = {"target": (2,)}

    @dataclass(frozen=True)
    class Options:
        #: m in front of the seat: where a policy that has learned nothing walks to
        ahead: float = 0.0

        def __post_init__(self) -> None:
            check_range(self, "ahead", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._origin = torch.tensor([options.ahead, 0.0], device=context.device)

    def compute(
        self, goal: Tensor, chair_position: Tensor, chair_rotation: Tensor
    ) -> dict[str, Tensor]:
        yaw = rotations.heading(chair_rotation)
        return {"target": chair_position[:, :2] + rotations.turned_flat(self._origin + goal, yaw)}
