"""L-BFGS for many independent problems of the same form at once, between bounds."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["minimise"]

_ARMIJO = 1e-4


@dataclass(frozen=True)
class Found:
    points: Tensor  #: (B, n)
    values: Tensor  #: (B,)
    iterations: int


def minimise(
    cost: Callable[[Tensor], Tensor],
    start: Tensor,
    low: Tensor,
    high: Tensor,
    iterations: int = 400,
    memory: int = 12,
    tolerance: float = 1e-9,
    halvings: int = 20,
) -> Found:
    """Points at which `cost` is small; each row goes its own way, with a step length of its own.

    The direction is that of the variables that are free: not at a bound that the gradient pushes
    against. Steps are projected on the bounds and halved until the value falls enough.

    *Limits:* a local minimum, within bounds of each variable alone; no other constraints.

    Parameters
    ----------
    cost
        (B, n) to (B,), differentiable; a row's value depends on its point alone.
    start
        (B, n).
    low, high
        (B, n) or (n,), bounds; equal ones hold a variable fixed.
    iterations
        at most.
    memory
        pairs of steps and changes of gradient that are kept.
    halvings
        of a step, at most.
    tolerance
        all rows are done where none falls by more than this share of its value.
    """
    low, high = low.expand_as(start), high.expand_as(start)
    point = start.clamp(low, high)
    value, slope = _with_gradient(cost, point)
    pairs: list[tuple[Tensor, Tensor, Tensor]] = []
    still = done = 0
    while done < iterations and still < 5:
        done += 1
        stuck = ((point <= low) & (slope > 0)) | ((point >= high) & (slope < 0))
        free = (~stuck & (high > low)).to(point.dtype)
        downhill = -slope * free
        direction = _two_loops(downhill, pairs, free)
        descends = (direction * slope).sum(1) < 0
        direction = torch.where(descends[:, None], direction, downhill)
        length = torch.ones_like(value)
        if not pairs:
            length = 0.05 / direction.abs().amax(1).clamp(min=1e-12)
        new, after, turned = point, value, None
        waiting = torch.ones_like(value, dtype=torch.bool)
        for halving in range(halvings):
            tried = (point + length[:, None] * direction).clamp(low, high)
            # Most often the first is taken: then what was worked out for it has the gradient, too.
            with torch.set_grad_enabled(halving == 0):
                reached = cost(tried.requires_grad_(halving == 0))
            found, ahead = reached.detach(), tried.detach()
            enough = found <= value + _ARMIJO * ((ahead - point) * slope).sum(1)
            take = waiting & enough & torch.isfinite(found)
            if halving == 0 and take.all():
                new, after = ahead, found
                (turned,) = torch.autograd.grad(reached.sum(), tried)
                break
            new = torch.where(take[:, None], ahead, new)
            waiting &= ~take
            if not waiting.any():
                break
            length = torch.where(waiting, 0.5 * length, length)
        if turned is None:
            after, turned = _with_gradient(cost, new)
        step, change = new - point, turned - slope
        curved = (step * change).sum(1)
        good = curved > 1e-12 * (change * change).sum(1).clamp(min=1e-30)
        pairs = (
            [*pairs[1 - memory :], (step, change, good)] if memory > 1 else [(step, change, good)]
        )
        fell = (value - after) > tolerance * value.abs().clamp(min=1e-12)
        still = 0 if bool(fell.any()) else still + 1
        point, value, slope = new, after, turned
        if still:  # the pairs may be of another landscape
            pairs = []
    return Found(point, value, done)


def _with_gradient(cost: Callable[[Tensor], Tensor], point: Tensor) -> tuple[Tensor, Tensor]:
    point = point.detach().requires_grad_(True)
    value = cost(point)
    (slope,) = torch.autograd.grad(value.sum(), point)
    return value.detach(), slope


def _two_loops(
    downhill: Tensor, pairs: list[tuple[Tensor, Tensor, Tensor]], free: Tensor
) -> Tensor:
    """The quasi-Newton direction of the free variables (Nocedal and Wright, algorithm 7.4)."""
    direction, kept = downhill, []
    for step, change, good in reversed(pairs):
        s, y = step * free, change * free
        curved = (s * y).sum(1)
        use = good & (curved > 1e-14)
        rho = torch.where(use, 1.0 / curved.clamp(min=1e-14), 0.0)
        alpha = rho * (s * direction).sum(1)
        direction = direction - alpha[:, None] * y
        kept.append((s, y, rho, alpha))
    if kept:
        s, y, rho, _ = kept[0]
        scale = torch.where(
            rho > 0, (s * y).sum(1) / (y * y).sum(1).clamp(min=1e-20), torch.ones_like(rho)
        )
        direction = scale[:, None] * direction
    for s, y, rho, alpha in reversed(kept):
        beta = rho * (y * direction).sum(1)
        direction = direction + (alpha - beta)[:, None] * s
    return direction * free
