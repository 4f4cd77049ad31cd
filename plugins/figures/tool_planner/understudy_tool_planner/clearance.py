"""How far a gripper, the hand and what is carried are from the table and from objects. m."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_hand.tools import HALF_LENGTH
from understudy_tool_planner.gripper import Rods
from understudy_tool_planner.objects import Things

_TINY = 1e-12


def to_segments(middle: Tensor, along: Tensor, things: Things, rounds: int = 4) -> Tensor:
    """(…, K) m: of segments of a stick's length around `middle` (…, 3), along the unit vectors `along` (…, 3),
    from the surfaces of `things`; negative inside.

    The nearest points are found by going back and forth between the two convex shapes, without gradients, and
    then held: moving them changes nothing there, so the gradients are those of the distance. One round is
    exact for spheres; more rounds bring the value down to the distance from above.
    """
    with torch.no_grad():
        point = _into(middle[..., None, :] - _wide(things.places, middle), things, middle)
        way = _into(along[..., None, :], things, middle)
        sizes = _wide(things.sizes, middle)
        place = (-(point * way).sum(-1)).clamp(-HALF_LENGTH, HALF_LENGTH)
        for _ in range(rounds):
            near = (point + place[..., None] * way).clamp(-sizes, sizes)
            place = ((near - point) * way).sum(-1).clamp(-HALF_LENGTH, HALF_LENGTH)
    there = middle[..., None, :] + place[..., None] * along[..., None, :]
    return to_points(there, things)


def to_points(points: Tensor, things: Things) -> Tensor:
    """(…, K) m: of a point (…, K or 1, 3) for each of `things` from its surface; negative inside.

    Things are (K, …), or (B, K, …) where points are (B, …).
    """
    middle = points[..., 0, :]
    local = _into(points - _wide(things.places, middle), things, middle)
    beyond = local.abs() - _wide(things.sizes, middle)
    outside = (beyond.clamp(min=0.0).square().sum(-1) + _TINY * _TINY).sqrt()
    return outside + beyond.amax(-1).clamp(max=0.0) - _wide(things.rounding, middle, 1)


def _wide(values: Tensor, of: Tensor, own: int = 2) -> Tensor:
    """(B, K, …) as (B, 1, …, K, …), to go with `of` (B, …, 3); (K, …) as it is. `own` dimensions are its own."""
    if values.dim() == own:
        return values
    return values.reshape(len(values), *[1] * (of.dim() - 2), *values.shape[1:])


def _into(vectors: Tensor, things: Things, of: Tensor) -> Tensor:
    """(…, K, 3) in the things' frames."""
    turns = _wide(things.turns, of, 3)
    return (vectors[..., None, :] @ turns)[..., 0, :]


def of_rods(rods: Rods, things: Things | None, rounds: int = 4) -> tuple[Tensor, Tensor]:
    """Clearance of a gripper: of its parts from the table (…, P), of its rods from things (…, R, K)."""
    if things is None or not len(things.places):
        return rods.low, rods.middles.new_zeros(*rods.middles.shape[:-1], 0)
    return rods.low, to_segments(rods.middles, rods.axes, things, rounds) - rods.radius
