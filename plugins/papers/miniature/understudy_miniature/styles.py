"""An arm of many joints that acts in what an auto-encoder learned of its usual poses."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import (
    ActionSpace,
    Actuation,
    Box,
    Context,
    Encoder,
    Fields,
    InitialStates,
    Scene,
    Shape,
)
from understudy_miniature.poses import trained_decoder
from understudy_tensors.limits import limits
from understudy_tensors.simulator import TensorSimulator


class ArmScene(Scene):
    """A chain of equal links in a plane, fixed at the origin; straight, it lies along the first axis."""

    @dataclass(frozen=True)
    class Options:
        joints: int = 8  #: how many, from 1
        length: float = 1.0  #: m, above 0, of all links together
        lag: float = 0.1  #: s, time constant with which a joint follows its target

        def __post_init__(self) -> None:
            check_range(self, "length", most=1e3)
            check_range(self, "joints", least=1, most=1000)
            check_range(self, "length", "lag", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options

    def describe(self) -> dict[str, Any]:
        return {"joints": self.options.joints, "length_m": self.options.length}


class Arm(TensorSimulator):
    """Each joint follows its target (N, J), rad, with a first-order lag, exactly.

    *Limits:* joints have no inertia and no ranges, and feel no weight.
    """

    state_fields = ("angles",)

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "simulator 'miniature/arm'").options
        self.control_size, self._substeps = scene.joints, context.substeps
        self.fields: Mapping[str, Shape] = {"angles": (scene.joints,)}
        angles = torch.zeros(context.num_worlds, scene.joints, device=context.device)
        self._state = {"angles": angles}
        self._share = 1 - math.exp(-context.control_dt / context.substeps / scene.lag)

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        for _ in range(substeps or self._substeps):
            self._state["angles"].lerp_(control, self._share)

    def failed(self) -> Tensor:
        return ~(self._state["angles"].abs() < 1e6).all(dim=1)


class Straight(InitialStates):
    """The arm nearly straight."""

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "initial_states 'miniature/straight'").options
        self._joints = scene.joints

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {"angles": 0.1 * streams.normal(self._joints)}


class Tip(Fields):
    """Where the arm ends, m."""

    reads = ("angles",)
    provides = {"tip": (2,)}

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "fields 'miniature/tip'").options
        self._link = scene.length / scene.joints

    def compute(self, angles: Tensor) -> dict[str, Tensor]:
        heading = angles.cumsum(dim=1)
        links = torch.stack([heading.cos(), heading.sin()], dim=2)
        return {"tip": self._link * links.sum(dim=1)}


class Posture(Encoder):
    """Joint angles and where the tip should go, (N, J + 2)."""

    reads = ("angles", "target")

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(ArmScene, "encoder 'miniature/posture'").options
        self.shape = (scene.joints + 2,)

    def encode(self, angles: Tensor, target: Tensor) -> Tensor:
        return torch.cat([angles, target], dim=1)


class DecodedPose(Actuation):
    """Joint targets: the pose that a trained decoder makes of a code, plus an offset that is zero
    unless it is large enough.

    The offset that was used is the field ``pose_offset``.
    """

    keeps: Mapping[str, Shape]

    @dataclass(frozen=True)
    class Options:
        run: str  #: folder of the run that trained the auto-encoder
        code_scale: float = 2.0  #: code for an action of 1, above 0
        offset_scale: float = 0.2  #: rad, above 0: the offset for an action of 1
        dead: float = 0.1  #: rad, size up to which an offset counts as none

        def __post_init__(self) -> None:
            check_range(self, "offset_scale", most=100)
            check_range(self, "code_scale", "offset_scale", above=0)
            check_range(self, "dead", least=0, most=100)

    def __init__(self, options: Options, context: Context) -> None:
        assert context.simulator is not None
        joints = context.simulator.control_size
        self._options = options
        self._decoder, code = trained_decoder(options.run, context)
        made = self._decoder(torch.zeros(1, code, device=context.device)).shape[1]
        if made != joints:
            raise ConfigError(
                f"actuation.run={options.run} makes poses of {made} joints; this arm has {joints}."
            )
        self.action_space = ActionSpace({"code": Box(code), "offset": Box(joints)})
        self.keeps = {"pose_offset": (joints,)}
        self._none = torch.zeros(context.num_worlds, joints, device=context.device)

    def _offset(self, action: Tensor) -> Tensor:
        offset = self._options.offset_scale * self.action_space.split(action)["offset"]
        return torch.where(offset.abs() < self._options.dead, 0.0, offset)

    def begin(self) -> dict[str, Tensor]:
        return {"pose_offset": self._none}

    def advance(self, action: Tensor) -> dict[str, Tensor]:
        return {"pose_offset": self._offset(action)}

    def control(self, action: Tensor) -> Tensor:
        code = self._options.code_scale * torch.tanh(self.action_space.split(action)["code"])
        return self._decoder(code) + self._offset(action)


@limits(scale=(1e-9, 1e3))
def sparse(
    pose_offset: Tensor,
    *,
    scale: float = 1.0,  #: rad, above 0: the mean offset at which the reward is 1/e
) -> Tensor:
    """exp(-mean |offset| / scale): 1 where the decoded pose is used as it is."""
    return torch.exp(-pose_offset.abs().mean(dim=1) / scale)
