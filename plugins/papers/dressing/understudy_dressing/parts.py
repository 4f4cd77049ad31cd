"""What the policy sees and does."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Actuation, Context, Encoder, box
from understudy_cloth.scene import ClothScene
from understudy_dressing.body import sensors
from understudy_dressing.person import PersonScene


class SleeveObservation(Encoder):
    """[cos q, sin q, q̇, haptics, feature and its displacement from the fingertip, task vector, signs]: 163 numbers
    with all 22 hinges (section 6). The gripper is not seen."""

    @dataclass(frozen=True)
    class Options:
        force: float = 1.0  #: N that is 1 to the policy; the paper's unit is not known
        #: without them the paper's ablations: haptics and signs, the task vector
        haptics: bool = True  #: whether forces and signs are seen
        task_vector: bool = True  #: whether the task vector is

        def __post_init__(self) -> None:
            check_range(self, "force", above=0)

    reads = (
        "qpos", "qvel", "sensor_force", "sensor_sign", "fingertip", "feature", "task_vector",
    )  # fmt: skip

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        self._hinges = len(context.need_scene(PersonScene, "encoder 'dressing/sleeve'").hinges)
        felt = 4 * len(sensors()) if options.haptics else 0
        self.shape = (3 * self._hinges + felt + 6 + (3 if options.task_vector else 0),)

    def encode(
        self, qpos: Tensor, qvel: Tensor, sensor_force: Tensor, sensor_sign: Tensor, fingertip: Tensor,
        feature: Tensor, task_vector: Tensor,
    ) -> Tensor:  # fmt: skip
        q, rate = qpos[:, : self._hinges], qvel[:, : self._hinges]
        parts = [q.cos(), q.sin(), rate]
        if self.options.haptics:
            parts.append(sensor_force.flatten(1) / self.options.force)
        parts += [feature, fingertip - feature]
        if self.options.task_vector:
            parts.append(task_vector)
        if self.options.haptics:
            parts.append(sensor_sign)
        return torch.cat(parts, dim=1)


class BodyObservation(Encoder):
    """[cos q, sin q, q̇, haptics, signs]: what all subtasks see, 154 numbers with all 22 hinges (section 6)."""

    @dataclass(frozen=True)
    class Options:
        force: float = 1.0  #: N that is 1 to the policy; the paper's unit is not known
        haptics: bool = True  #: whether forces and signs are seen

        def __post_init__(self) -> None:
            check_range(self, "force", above=0)

    reads = ("qpos", "qvel", "sensor_force", "sensor_sign")

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        self._hinges = len(context.need_scene(PersonScene, "encoder 'dressing/body'").hinges)
        self.shape = (3 * self._hinges + (4 * len(sensors()) if options.haptics else 0),)

    def encode(
        self, qpos: Tensor, qvel: Tensor, sensor_force: Tensor, sensor_sign: Tensor
    ) -> Tensor:
        q, rate = qpos[:, : self._hinges], qvel[:, : self._hinges]
        parts = [q.cos(), q.sin(), rate]
        if self.options.haptics:
            parts += [sensor_force.flatten(1) / self.options.force, sensor_sign]
        return torch.cat(parts, dim=1)


class Reach(Encoder):
    """[target, fingertip, difference] of the hand that is to grip: 9 numbers (2018 code)."""

    reads = ("grip_target", "hand")
    shape = (9,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, grip_target: Tensor, hand: Tensor) -> Tensor:
        return torch.cat([grip_target, hand, grip_target - hand], dim=1)


class Torques(Actuation):
    """Torques of the hinges that move, in shares of their largest, cut at ±1; grips hold or not, as `closed` says."""

    @dataclass(frozen=True)
    class Options:
        closed: tuple[bool, ...] = (True,)  #: of each grip of the garment, whether it holds
        #: an action of 1 asks for so much of a hinge's largest torque (paper: all)
        most: float = 1.0

        def __post_init__(self) -> None:
            check_range(self, "most", above=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        person = context.need_scene(PersonScene, "actuation 'dressing/torques'")
        garment = context.need_scene(ClothScene, "actuation 'dressing/torques'")
        grips = len(garment.model().grips)
        if len(options.closed) != grips:
            raise ConfigError(
                f"actuation.closed={list(options.closed)} does not fit: the garment has {grips} grips."
            )
        hinges, simulator = len(person.hinges), context.simulator
        if not hinges:
            raise ConfigError(
                "scenes.person.still leaves no hinge that could move: name fewer of them."
            )
        # by itself; a gripper's policy has the person's within it
        alone = options in [one.options for one in context.chosen.get("actuation", ())]
        if alone and simulator is not None and simulator.control_size != hinges + grips:
            raise ConfigError(
                f"actuation 'dressing/torques' gives {hinges} torques and {grips} grips, and the simulator takes {simulator.control_size} "
                "controls. Leave the gripper without motors (scenes.person.driven=false), and let a coupling drive all tools "
                "(couplings.touch.name=composite/tools)."
            )
        self.action_space = box(len(person.hinges))
        self._most = options.most
        self._closed = torch.tensor(options.closed, dtype=torch.float32, device=context.device)

    def control(self, action: Tensor) -> Tensor:
        closed = self._closed.expand(len(action), -1)
        return torch.cat([self._most * action.clamp(-1.0, 1.0), closed], dim=1)
