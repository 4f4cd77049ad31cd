"""Terminations, rewards and measures of a jump (thesis, section 4.6.1)."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_tensors.limits import limits


def crashed(crashed: Tensor) -> Tensor:
    """It has touched what it must not."""
    return crashed != 0


def landed(landed: Tensor) -> Tensor:
    """It has landed behind the obstacle; to be used with ``outcome: success``."""
    return landed != 0


@limits(scale=(0, 1e6))
def spin(
    mean_spin: Tensor,
    *,
    scale: float = 0.02,  #: s/rad, factor of the angular velocities (eq. 4.15)
) -> Tensor:
    """r_ω = exp(-0.02 ‖ω‖) (eq. 4.15), of the mean of the root's angular speed over the episode."""
    return torch.exp(-scale * mean_spin)


@limits(unsafe=(0, 1))
def safety(
    head_first: Tensor,
    *,
    #: the reward of a landing on the head, in [0, 1] (section 4.6.1)
    unsafe: float = 0.7,
) -> Tensor:
    """r_safety (eq. 4.15): `unsafe` of a landing on the head, else 1."""
    return torch.where(head_first != 0, unsafe, 1.0)


@limits(upside_down=(0, 1))
def lying(
    root_axes: Tensor,
    *,
    #: the reward where the trunk is upside down, in [0, 1]; ours, since the thesis asks only that the head does not touch first
    upside_down: float = 0.3,
) -> Tensor:
    """From `upside_down` to 1, by how far the trunk is from upside down; 1 where it lies or is upright. A factor beside `complete`, it
    counts as the jump lands."""
    return 1.0 - (1.0 - upside_down) * (-root_axes[:, 5]).clamp(0.0, 1.0)


def fell(came_down: Tensor, landed: Tensor) -> Tensor:
    """It lies on the mat, and has not landed as it should."""
    return (came_down != 0) & (landed == 0)


@limits(fallen=(0, 1))
def feet_first(
    on_feet: Tensor,
    *,
    #: the reward of a landing on anything else, in [0, 1]; ours, since the thesis gives none
    fallen: float = 0.3,
) -> Tensor:
    """r_safety engineered for a landing on feet (section 4.6.1): from `fallen` to 1, by the share of the feet that touched the mat before
    anything else did."""
    return fallen + (1.0 - fallen) * on_feet
