"""Averages over the processes of a training, which may be a single one."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor, nn

from understudy import distributed

__all__ = ["average", "average_gradients", "mean", "moments"]


def mean(value: Tensor) -> Tensor:
    """The mean of `value` over processes."""
    return distributed.total(value) / distributed.size()


def moments(value: Tensor) -> tuple[Tensor, Tensor, Tensor]:
    """Count (), mean (D,) and population variance (D,) of the rows `value` (B, D) of all processes."""
    rows = torch.full((), float(value.shape[0]), dtype=value.dtype, device=value.device)
    count = distributed.total(rows)
    mean = distributed.total(value.sum(0)) / count
    return count, mean, distributed.total((value - mean).square().sum(0)) / count


def average(values: Tensor) -> None:
    """Average `values` over processes, in place."""
    if distributed.size() > 1:
        distributed.add_up(values)
        values /= distributed.size()


def average_gradients(parameters: Sequence[nn.Parameter], values: Tensor) -> Tensor:
    """Average the gradients of `parameters` in place; returns `values` (K,) averaged with them."""
    if distributed.size() == 1:
        return values
    gradients = [p.grad for p in parameters if p.grad is not None]
    flat = torch.cat([g.flatten() for g in gradients] + [values])
    distributed.add_up(flat)
    flat /= distributed.size()
    parts = flat.split([g.numel() for g in gradients] + [values.numel()])
    for gradient, part in zip(gradients, parts, strict=False):
        gradient.copy_(part.view_as(gradient))
    return parts[-1]
