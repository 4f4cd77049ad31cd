"""Rewards for standing."""

import torch
from torch import Tensor

from understudy_basics.rotations import tangent_normal


def upright(root_rotation: Tensor, *, scale: float = 0.5) -> Tensor:
    """exp(-angle / scale), (N,): the angle in rad between the trunk's axis and the vertical."""
    axis = tangent_normal(root_rotation)[:, 3:]
    return torch.exp(-torch.acos(axis[:, 2].clamp(-1.0, 1.0)) / scale)
