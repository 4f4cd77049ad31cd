"""Sticks or tongs as a gripper of seven degrees of freedom around an object (thesis, sections 5.6.1 and 5.7.4).

The line through both tips passes the object's middle, so of a gripper only the lower part's orientation is
free: its position and the angle of closing follow. m, rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy_hand.tools import BAR, GRIPPERS, HALF_LENGTH, RADIUS, Tool
from understudy_tool_planner.objects import Shape

__all__ = ["Jaws"]

#: m: how far an open gripper is from the object on each side.
ROOM = 0.003
#: m: from a bar's end to where it takes, as far as a stick's round end reaches beyond its tip.
_BEFORE = 0.004
#: m from a bar's axis: rods that are its shape to whatever is in its way; each covers a third of the breadth.
_RODS = (-2.0 * BAR[2] / 3.0, 0.0, 2.0 * BAR[2] / 3.0)


@dataclass(frozen=True)
class Rods:
    """What is in the way: R rods of one radius, and how far down the gripper's P parts reach."""

    middles: Tensor  #: (…, R, 3) m, of segments of a tool's length
    axes: Tensor  #: (…, R, 3) unit vectors along them
    low: Tensor  #: (…, P) m: the parts' lowest points above the table
    radius: float  #: m


class Jaws:
    """Both parts of the tool `tool`, the upper one turned about a pivot of the lower one."""

    def __init__(self, tool: Tool) -> None:
        if (hangs := GRIPPERS.get(tool)) is None:
            raise ConfigError(
                f"A plan to take an object needs a tool of two parts, and the scene has tool={tool}. "
                f"Set scene.tool to one of: {', '.join(GRIPPERS)}."
            )
        self._bars = tool == "tongs"
        self._x, self._y, _ = hangs.pivot
        self._along, self._zero = hangs.along, hangs.zero
        self._tip = HALF_LENGTH - _BEFORE if self._bars else HALF_LENGTH
        #: m from the pivot to where the upper part takes.
        self._lever = self._along + self._tip
        #: m from a part's axis to what it takes.
        self.thickness = BAR[1] if self._bars else RADIUS

    def tips(self, angle: Tensor) -> tuple[Tensor, Tensor]:
        """(…, 3), in the lower part's frame: the middle between both tips, and the way from the lower to the
        upper one."""
        zero, turn = torch.zeros_like(angle), angle + self._zero
        across = torch.stack(
            [
                self._x + self._tip - self._lever * turn.cos(),
                self._y - self._lever * turn.sin(),
                zero,
            ],
            -1,
        )
        lower = torch.stack([zero - self._tip, zero, zero], -1)
        return lower + 0.5 * across, across

    def angle_of(self, gap: Tensor) -> Tensor:
        """(…) rad, at which the tips' axes are `gap` (…) m apart."""
        # |across|² = 2 L² + y² - 2 L² cos φ - 2 y L sin φ, where the pivot is as far along both parts
        a, b = 2.0 * self._lever * self._lever, 2.0 * self._y * self._lever
        size, turn = (a * a + b * b) ** 0.5, torch.atan2(torch.tensor(b), torch.tensor(a))
        share = (a + self._y * self._y - gap.square()) / size
        return turn.to(gap) - torch.acos(share.clamp(-1.0, 1.0)) - self._zero

    def room(self, angle: float) -> float:
        """m between both parts at the tips, where they are closed by `angle`."""
        _, across = self.tips(torch.tensor(angle, dtype=torch.float64))
        return float(across.square().sum().sqrt()) - 2.0 * self.thickness

    def angles_for(self, across: Tensor, least: float) -> tuple[Tensor, Tensor]:
        """(…) rad, closed around and open beside something `across` (…) m wide; at least `least`."""
        closed = self.angle_of(across + 2.0 * self.thickness)
        wide = self.angle_of(across + 2.0 * (self.thickness + ROOM))
        return closed.clamp(min=least), wide.clamp(min=least)

    def placed(self, matrix: Tensor, angle: Tensor, middle: Tensor) -> Tensor:
        """(…, 3) m: where the lower part, turned by `matrix` (…, 3, 3), is, if the tips' middle is `middle`."""
        centre, _ = self.tips(angle)
        return middle - torch.einsum("...ij,...j->...i", matrix, centre)

    def rods(self, place: Tensor, matrix: Tensor, angle: Tensor) -> Rods:
        """The gripper whose lower part is at `place` (…, 3), turned by `matrix` (…, 3, 3), the upper one's first."""
        x, y, z = matrix[..., 0], matrix[..., 1], matrix[..., 2]
        turn = angle + self._zero
        cosine, sine = turn.cos()[..., None], turn.sin()[..., None]
        upper = cosine * x + sine * y
        pivot = place + self._x * x + self._y * y
        middles = torch.stack([pivot - self._along * upper, place], dim=-2)
        axes = torch.stack([upper, x], dim=-2)
        low = middles[..., 2] - HALF_LENGTH * axes[..., 2].abs()
        if not self._bars:
            return Rods(middles, axes, low - RADIUS, RADIUS)
        across = torch.stack([cosine * y - sine * x, y], dim=-2)
        low = low - BAR[1] * across[..., 2].abs() - BAR[2] * z[..., 2, None].abs()
        beside = z.new_tensor(_RODS)[:, None] * z[..., None, None, :]  # (…, 1, 3, 3)
        middles = (middles[..., :, None, :] + beside).flatten(-3, -2)
        around = (BAR[1] ** 2 + (BAR[2] / 3.0) ** 2) ** 0.5
        return Rods(middles, axes.repeat_interleave(len(_RODS), dim=-2), low, around)


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
        along, round_ = shape.half_sizes[0], shape.rounding
        across = (1.0 - ways[..., 0].square()).clamp(min=0.0).sqrt()
        # beside its cylinder, or out of an end, as in `width`
        out = (1.0 - (along / round_ * across).square()).clamp(min=0.0).sqrt()
        return torch.where(round_ * ways[..., 0].abs() <= along * across, across, out)
    return torch.ones_like(ways[..., 0])
