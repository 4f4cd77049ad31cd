"""Acting by natural poses: the decoded pose plus offsets as PD targets (thesis, section 4.4.2)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import ActionSpace, Actuation, Box, Context, Shape
from understudy_characters.scene import CharacterScene
from understudy_characters.target_limits import Range, target_limits
from understudy_pose_vae.features import joint_rotations
from understudy_pose_vae.job import trained_poses
from understudy_pose_vae.targets import ServoTargets


class PoseOffset(Actuation):
    """PD targets D_pose(a_latent) + a_offset, with offsets of all U servos, in rad.

    a_latent = 0 is the mean code of the clips and a unit one standard deviation. Where the offsets' sum
    of absolute values is above ``offset_limit`` they are scaled down to it, as in the authors' release.
    Targets are cut to the joints' ``ranges``, and to the control ranges of the model's servos. Where a joint is
    beyond its ``limits``, a target that is further beyond is brought back to them, in every control period (4.6.2
    has "penalty forces"; the authors' release does so in every physics step, by swing and twist).

    It keeps ``pose_offset`` (N, U), a_offset in rad, and ``offset_norm`` (N,), ‖a_offset‖₁ in rad.
    """

    @dataclass(frozen=True)
    class Options:
        run: str  #: folder of the run that trained the auto-encoder
        latent_scale: float = 1.0  #: standard deviations of the codes, for one unit of the action
        #: rad, offset for one unit of the action; the authors' release has 2
        offset_scale: float = 2.0
        offset_limit: float | None = None  #: rad, greatest ‖a_offset‖₁; null sets no limit
        #: rad, ranges of the targets by joint: (least, most) of each axis; a joint that is not
        #: given has no limit
        ranges: Mapping[str, tuple[Range, ...]] = field(default_factory=dict)
        #: rad, ranges of the joints themselves, likewise; a joint that is not given has no limit
        limits: Mapping[str, tuple[Range, ...]] = field(default_factory=dict)

        def __post_init__(self) -> None:
            check_range(self, "offset_scale", "offset_limit", most=100)
            check_range(self, "latent_scale", "offset_scale", "offset_limit", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "actuation 'pose_vae/offset'")
        trained = trained_poses(options.run, context)
        source = f"actuation.run={options.run}"
        self._options, self._network = options, trained.network
        self._joints = len(trained.joints)
        self._targets = ServoTargets(scene.character, trained.joints, source, context.device)
        self._low, self._high = target_limits(scene, options.ranges, context.device)
        if options.limits:
            self.reads, self.every = ("actuator_length",), "period"
            self._least, self._most = target_limits(
                scene, options.limits, context.device, option="actuation.limits"
            )
        servos, latent = scene.layout.num_actuators, len(trained.network.code_mean)
        self.action_space = ActionSpace({"latent": Box(latent), "offset": Box(servos)})
        self.keeps: Mapping[str, Shape] = {"pose_offset": (servos,), "offset_norm": ()}
        self._none = torch.zeros(context.num_worlds, servos, device=context.device)

    def begin(self, **fields: Tensor) -> dict[str, Tensor]:
        return {"pose_offset": self._none, "offset_norm": self._none[:, 0]}

    def advance(self, action: Tensor, **fields: Tensor) -> dict[str, Tensor]:
        offset = self._offset(action)
        return {"pose_offset": offset, "offset_norm": offset.abs().sum(1)}

    def control(self, action: Tensor, actuator_length: Tensor | None = None) -> Tensor:
        network, latent = self._network, self.action_space.split(action)["latent"]
        code = network.code_mean + self._options.latent_scale * latent * network.code_std
        pose = joint_rotations(network.decoder(code), self._joints)
        target = self._targets(pose) + self._offset(action)
        if actuator_length is not None:
            target = torch.where(
                actuator_length < self._least, target.clamp(min=self._least), target
            )
            target = torch.where(actuator_length > self._most, target.clamp(max=self._most), target)
        return target.clamp(self._low, self._high)

    def _offset(self, action: Tensor) -> Tensor:
        offset = self._options.offset_scale * self.action_space.split(action)["offset"]
        limit = self._options.offset_limit
        if limit is None:
            return offset
        norm = offset.abs().sum(1, keepdim=True)
        return offset * (limit / norm.clamp(min=limit))
