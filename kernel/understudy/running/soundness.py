"""Whether the numbers of a world are sound: finite, and of a sane size."""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["rows", "sound", "without_unsound"]

#: Numbers of this size and beyond count as non-finite, as they do for MuJoCo.
LARGEST = 1e10


def rows(mask: Tensor, like: Tensor) -> Tensor:
    """`mask` (N,) shaped to broadcast over the rows of `like` (N, …)."""
    return mask.view(-1, *([1] * (like.dim() - 1)))


def sound(value: Tensor) -> Tensor:
    """(N,) bool: whether every number in a row of `value` (N, …) is finite and of sane size."""
    size = value.abs()[:, None].flatten(1)  # amax is NaN where a number is; it takes no empty rows
    return size.amax(dim=1) < LARGEST if size.shape[1] else (size < LARGEST).all(dim=1)


def without_unsound(value: Tensor) -> Tensor:
    """`value` (N, …), but 0 in rows that are not sound."""
    return torch.where(rows(sound(value), value), value, 0) if value.is_floating_point() else value
