"""How upright the trunk is: a reward and a termination."""

import torch
from torch import Tensor

from understudy_tensors.rotations import tangent_normal


def lean(root_rotation: Tensor) -> Tensor:
    """(N,) rad between the trunk's axis and the vertical, from `root_rotation` (N, 4)."""
    axis = tangent_normal(root_rotation)[:, 3:]
    return torch.acos(axis[:, 2].clamp(-1.0, 1.0))


def upright(
    root_rotation: Tensor,
    *,
    scale: float = 0.5,  #: rad, above 0
) -> Tensor:
    """exp(-lean / scale), (N,)."""
    return torch.exp(-lean(root_rotation) / scale)


def leaning(
    root_rotation: Tensor,
    *,
    limit: float = 1.0,  #: rad
) -> Tensor:
    """(N,) bool: the trunk leans by more than `limit` rad."""
    return lean(root_rotation) > limit
