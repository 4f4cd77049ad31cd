"""Two sticks as a gripper of seven degrees of freedom around an object (thesis, section 5.6.1).

The line through both tips passes the object's middle, so of a gripper only the lower stick's orientation is
free: its position and the angle between the sticks follow. m, rad.
"""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_hand.tools import HALF_LENGTH, RADIUS, STICKS
from understudy_tool_planner.objects import Shape

_PIVOT_X, _PIVOT_Y, _ = STICKS.pivot
_LEVER = STICKS.along + HALF_LENGTH
#: m between the sticks' axes at the tips, of parallel sticks.
WIDEST = _PIVOT_Y
#: m: how far open sticks are from the object on each side.
ROOM = 0.003


def tips(angle: Tensor) -> tuple[Tensor, Tensor]:
    """(…, 3), in the lower stick's frame: the middle between both tips, and the way from the lower to the
    upper one."""
    zero = torch.zeros_like(angle)
    across = torch.stack(
        [_PIVOT_X + HALF_LENGTH - _LEVER * angle.cos(), _PIVOT_Y - _LEVER * angle.sin(), zero], -1
    )
    lower = torch.stack([zero - HALF_LENGTH, zero, zero], -1)
    return lower + 0.5 * across, across


def angle_of(gap: Tensor) -> Tensor:
    """(…) rad, at which the tips' axes are `gap` (…) m apart; at least 0, where they are widest."""
    # |across|² = 2 L² + y² - 2 L² cos φ - 2 y L sin φ, with x of the pivot and the lever cancelling at φ = 0
    a, b = 2.0 * _LEVER * _LEVER, 2.0 * _PIVOT_Y * _LEVER
    size, turn = (a * a + b * b) ** 0.5, torch.atan2(torch.tensor(b), torch.tensor(a))
    share = (a + _PIVOT_Y * _PIVOT_Y - gap.square()) / size
    return (turn.to(gap) - torch.acos(share.clamp(-1.0, 1.0))).clamp(min=0.0)


def width(shape: Shape, ways: Tensor) -> Tensor:
    """(…) m: how wide `shape` is through its middle along the unit vectors `ways` (…, 3), in its frame."""
    sizes = ways.new_tensor(shape.half_sizes)
    if shape.kind == "box":
        return 2.0 * (sizes / ways.abs().clamp(min=1e-9)).amin(-1)
    across = (1.0 - ways[..., 0].square()).clamp(min=1e-9).sqrt()
    if shape.kind == "capsule":
        # beside its cylinder, or out of an end
        beside = shape.rounding / across
        end = (
            sizes[0] * ways[..., 0].abs()
            + (shape.rounding**2 - (sizes[0] * across).square()).clamp(min=0.0).sqrt()
        )
        return 2.0 * torch.where(beside * ways[..., 0].abs() <= sizes[0], beside, end)
    return torch.full_like(across, 2.0 * shape.rounding)


def normal(shape: Shape, ways: Tensor) -> Tensor:
    """(…) in [0, 1]: the cosine of the unit vectors `ways` (…, 3) and the surface's normal where they leave it."""
    if shape.kind == "box":
        sizes = ways.new_tensor(shape.half_sizes)
        face = (sizes / ways.abs().clamp(min=1e-9)).argmin(-1, keepdim=True)
        return ways.abs().gather(-1, face)[..., 0]
    if shape.kind == "capsule":
        return (1.0 - ways[..., 0].square()).clamp(min=0.0).sqrt()
    return torch.ones_like(ways[..., 0])


def placed(matrix: Tensor, angle: Tensor, middle: Tensor) -> Tensor:
    """(…, 3) m: where the lower stick, turned by `matrix` (…, 3, 3), is, if the tips' middle is `middle`."""
    centre, _ = tips(angle)
    return middle - torch.einsum("...ij,...j->...i", matrix, centre)


def axes(matrix: Tensor, angle: Tensor) -> Tensor:
    """(…, 2, 3): unit vectors along both sticks, the upper one first."""
    x, y = matrix[..., 0], matrix[..., 1]
    upper = angle.cos()[..., None] * x + angle.sin()[..., None] * y
    return torch.stack([upper, x], dim=-2)


def middles(place: Tensor, matrix: Tensor, angle: Tensor) -> Tensor:
    """(…, 2, 3) m: of both sticks, the upper one first, of a lower one at `place` (…, 3)."""
    x, y = matrix[..., 0], matrix[..., 1]
    upper = angle.cos()[..., None] * x + angle.sin()[..., None] * y
    pivot = place + _PIVOT_X * x + _PIVOT_Y * y
    return torch.stack([pivot - STICKS.along * upper, place], dim=-2)


def angles_for(across: Tensor) -> tuple[Tensor, Tensor]:
    """(…) rad, closed around and open beside something `across` (…) m wide."""
    return angle_of(across + 2.0 * RADIUS), angle_of(across + 2.0 * (RADIUS + ROOM))
