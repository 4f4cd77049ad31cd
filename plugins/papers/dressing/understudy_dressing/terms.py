"""Rewards of section 7, one term each. Weights are the tasks'."""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.task import Context
from understudy_dressing.person import PersonScene, neutral_pose
from understudy_tensors.limits import limits


@limits(middle=(0, 1e3), scale=(0, 1e6))
def deformation(
    area_ratio: Tensor,
    *,
    middle: float = 1.5,  #: w_mid, the ratio of areas at which half is taken (paper: 25, of a softer cloth)
    scale: float = 7.0,  #: w_scale: with 7 nothing below 1.1, all beyond 1.9 (paper: 0.14, so 15 and 35)
) -> Tensor:
    """Equation 13: from 0 to −1 as the cloth's most stretched triangle tears, (N,)."""
    return -0.5 * torch.tanh(scale * (area_ratio - middle)) - 0.5


def geodesic(contained: Tensor, touched_geodesic: Tensor) -> Tensor:
    """Equations 14 and 15: 1 − the distance along the cloth from what the fingertip touches to the opening, as a
    share of the largest; 0 without contact, 1 once the limb is in; (N,)."""
    return torch.where(contained > 0, 1.0, 1.0 - touched_geodesic)


def along_task_vector(
    fingertip_offset: Tensor, previous_fingertip_offset: Tensor, previous_task_vector: Tensor
) -> Tensor:
    """Equation 16: how far the fingertip went along the task vector in this decision, seen from the
    shoulder, m, (N,)."""
    return ((fingertip_offset - previous_fingertip_offset) * previous_task_vector).sum(dim=1)


class AlongWay:
    """exp(−‖q − q̂‖²/width²) of the pose and that of the way along which ``job=dressing/lead`` led the arm, at this decision, the
    last one from its end on; ours, (N,)."""

    @dataclass(frozen=True)
    class Options:
        width: float = 1.0  #: rad, distance over all hinges at which the reward is 1/e

        def __post_init__(self) -> None:
            check_range(self, "width", above=0, most=100)

    def __init__(self, options: Options, context: Context) -> None:
        self._scale, self._decision = options.width**-2, context.decision

    def __call__(self, qpos: Tensor, way: Tensor, episode_step: Tensor) -> Tensor:
        number = (episode_step // self._decision - 1).clamp(min=0, max=way.shape[1] - 1)
        wanted = way[torch.arange(len(way), device=way.device), number]
        return torch.exp(-self._scale * (qpos[:, : way.shape[2]] - wanted).square().sum(dim=1))


class TargetPose:
    """Equation 17 without its last two terms: −‖q − q̄‖ over the hinges, rad, (N,). q̄ is neutral: all 0, elbows
    0.21."""

    def __init__(self, options: None, context: Context) -> None:
        person = context.need_scene(PersonScene, "reward 'dressing/target_pose'")
        self._pose = neutral_pose(person).to(context.device)

    def __call__(self, qpos: Tensor) -> Tensor:
        return -(qpos[:, : len(self._pose)] - self._pose).norm(dim=1)


class PoseError:
    """‖q − q̄‖ over the hinges, rad, from the neutral pose, (N,); figure 9's lower curve."""

    def __init__(self, options: None, context: Context) -> None:
        self._closeness = TargetPose(options, context)

    def __call__(self, qpos: Tensor) -> Tensor:
        return -self._closeness(qpos)


@limits(enough=(0, 1))
def on_the_way(
    most_progress: Tensor,
    *,
    enough: float = 0.75,  #: progress, in [0, 1], up to which decisions count (section 9: 0.75)
) -> Tensor:
    """1 until `enough` was reached for the first time in the episode, (N,): summed, the decisions that it takes."""
    return (most_progress < enough).float()


class Upright:
    """−Σ|q| over the hinges that begin with `part`, not below `least`: the 2018 code's, not in the paper; (N,)."""

    @dataclass(frozen=True)
    class Options:
        part: str = "torso"  #: `torso`, or `neck` for the head's
        least: float = -2.5  #: rad, least value of the reward (2018 code: −2.5, head −1.2)

        def __post_init__(self) -> None:
            check_range(self, "least", least=-100, most=0)

    def __init__(self, options: Options, context: Context) -> None:
        person = context.need_scene(PersonScene, "reward 'dressing/upright'")
        found = [i for i, hinge in enumerate(person.hinges) if hinge.name.startswith(options.part)]
        if not found:
            raise ConfigError(
                f"reward 'dressing/upright': no hinge that moves begins with '{options.part}'."
            )
        self._hinges, self._least = torch.tensor(found, device=context.device), options.least

    def __call__(self, qpos: Tensor) -> Tensor:
        return -qpos[:, self._hinges].abs().sum(dim=1).clamp(max=-self._least)
