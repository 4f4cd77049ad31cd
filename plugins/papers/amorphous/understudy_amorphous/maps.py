"""The material as images: density and height maps (Zhang et al. 2020, section 3.2), and the goal.

A map is a square of N × N cells of width h, its first axis along x, its second along y. Heights are
along z, which the paper calls y.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Encoder, Fields, Shape
from understudy_amorphous.scene import AmorphousScene
from understudy_tensors import rotations

#: A particle counts in its own cell and in two rings around it.
_RINGS = 2
#: Half the width of that neighbourhood, in cells.
_REACH = _RINGS + 0.5


@dataclass(frozen=True)
class Grid:
    """N × N cells of width h around the origin of a frame."""

    cells: int = 32  #: N, cells along each side, 2 to 1024 (figure 3)
    width: float = 0.2  #: h, m, above 0: width of a cell

    def __post_init__(self) -> None:
        check_range(self, "cells", least=2, most=1024)
        check_range(self, "width", above=0, most=1e3)


def spread(points: Tensor, values: Tensor, grid: Grid) -> Tensor:
    """Values of points, weighted by eq. 3 and summed over cells (eq. 2).

    Parameters
    ----------
    points : (B, P, 2), m, in the frame of the grid
    values : (B, P, V)

    Returns
    -------
    (B, V, N, N)
        ``sum_k w(k, i, j) · values[k]`` over the points at most 2.5 h from the centre of cell (i, j)
        along both axes.
    """
    worlds, _, size = values.shape
    cells, h = grid.cells, grid.width
    ring = torch.arange(-_RINGS, _RINGS + 1, device=points.device)
    at = points / h + 0.5 * cells  # in cells, from the corner
    cell = at.floor().unsqueeze(-1) + ring  # (B, P, 2, 5)
    away = (at.unsqueeze(-1) - cell - 0.5).abs() * h
    near = (_REACH * h - away).clamp(min=0.0).square()
    inside = (cell >= 0) & (cell < cells)
    weight = (near[:, :, 0, :, None] + near[:, :, 1, None, :]).sqrt()  # (B, P, 5, 5), eq. 3
    weight = weight * (inside[:, :, 0, :, None] & inside[:, :, 1, None, :])
    index = cell.long().clamp(0, cells - 1)  # in this order NaN too has a place
    index = index[:, :, 0, :, None] * cells + index[:, :, 1, None, :]
    index = index + torch.arange(worlds, device=points.device).view(-1, 1, 1, 1) * cells * cells
    weighted = weight.unsqueeze(-1) * values[:, :, None, None, :]
    found = torch.zeros(worlds * cells * cells, size, device=points.device, dtype=points.dtype)
    found.index_add_(0, index.flatten(), weighted.reshape(-1, size))
    return found.view(worlds, cells, cells, size).permute(0, 3, 1, 2)


def density(points: Tensor, grid: Grid) -> Tensor:
    """The density map D (eq. 2) of `points` (B, P, 2 or 3): (B, N, N)."""
    return spread(points[..., :2], torch.ones_like(points[..., :1]), grid)[:, 0]


def density_and_height(points: Tensor, grid: Grid) -> tuple[Tensor, Tensor]:
    """D, and the height map H (section 3.2.2) of `points` (B, P, 3), each (B, N, N); H is 0 in cells
    without material."""
    values = torch.cat([torch.ones_like(points[..., :1]), points[..., 2:]], dim=-1)
    sums = spread(points[..., :2], values, grid)
    return sums[:, 0], sums[:, 1] / torch.where(sums[:, 0] > 0, sums[:, 0], 1.0)


def in_tool_frame(points: Tensor, position: Tensor, orientation: Tensor) -> Tensor:
    """A⁻¹ x (section 3.2.3): `points` (B, P, 3) seen from a tool at `position` (B, 3) with
    `orientation` (B, 4)."""
    moved = points - position.unsqueeze(1)
    return rotations.inverse_rotate(orientation.unsqueeze(1), moved)


class MaterialMaps(Encoder):
    """The images that the policy sees, O_mat (section 3.3.1), (C, N, N), in the order of ``channels``.

    In the tool's frame the maps move and turn with the tool (with its whole pose: for a tilted scraper,
    heights are along its own blade); in the world's frame they are around ``centre``. The goal is drawn as a
    single particle would be.
    """

    @dataclass(frozen=True)
    class Options:
        #: the images, in this order: what is there, how high, and where the goal is
        channels: tuple[Literal["density", "height", "goal"], ...] = ("density",)
        #: whether the maps move with the tool (section 3.3.1) or stay where they are
        frame: Literal["tool", "world"] = "tool"
        grid: Grid = Grid()  #: how many cells, and how large
        centre: tuple[float, float] = (0.0, 0.0)  #: m, of maps in the world's frame
        #: By what eq. 2's sums are multiplied, so that a layer of particles is about 1 in cells of
        #: 0.2 m. Of smaller particles (``scene.resolution``) each counts less: the same material makes
        #: the same map.
        scale: float = 0.1
        height_scale: float = 1.0  #: 1/m, above 0, by which heights are multiplied

        def __post_init__(self) -> None:
            check_range(self, "scale", "height_scale", above=0)
            check_range(self, "centre", least=-1e3, most=1e3)
            if not self.channels or len(set(self.channels)) != len(self.channels):
                raise ValueError(
                    f"channels={list(self.channels)} is not possible: name each of density, height "
                    "and goal at most once."
                )

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        self.shape: Shape = (len(options.channels), options.grid.cells, options.grid.cells)
        self.reads = ("particle_position", "tool_position", "tool_orientation")
        if "goal" in options.channels:
            self.reads = (*self.reads, "goal")
        scene = context.need_scene(AmorphousScene, "encoder 'amorphous/maps'")
        self._scaled = replace(options, scale=options.scale / scene.options.resolution**3)

    def encode(self, **fields: Tensor) -> Tensor:
        return draw_maps(self._scaled, **fields)


def draw_maps(
    options: MaterialMaps.Options,
    particle_position: Tensor,
    tool_position: Tensor,
    tool_orientation: Tensor,
    goal: Tensor | None = None,
) -> Tensor:
    """The maps (N, C, cells, cells) that `options` describe, of a scene with one tool.

    ``particle_position`` (N, P, 3) m, ``tool_position`` (N, 3) m, ``tool_orientation`` (N, 4), ``goal``
    (N, 2) m on the table.
    """

    def seen(points: Tensor) -> Tensor:
        if options.frame == "tool":
            return in_tool_frame(points, tool_position, tool_orientation)
        x, y = options.centre
        return torch.stack([points[..., 0] - x, points[..., 1] - y, points[..., 2]], dim=-1)

    material, height = density_and_height(seen(particle_position), options.grid)
    found = {"density": options.scale * material, "height": options.height_scale * height}
    if goal is not None:
        on_table = torch.nn.functional.pad(goal, (0, 1)).unsqueeze(1)
        peak = 2**0.5 * _REACH * options.grid.width  # what eq. 3 gives at a cell's centre
        found["goal"] = density(seen(on_table), options.grid) / peak
    return torch.stack([found[name] for name in options.channels], dim=1)


class TableMap(Fields):
    """How many cells of a map have material, D > 0: ``occupied_cells`` ().

    The world's map covers the table; Table 4 counts its cells, and the tool's motion changes no number.
    In the tool's frame it is "the observed height map", whose cells eq. 7 counts (section 4.6.2): it
    moves, turns and tilts with the tool as :class:`MaterialMaps` do, and what leaves it counts no more.
    """

    provides = {"occupied_cells": ()}

    @dataclass(frozen=True)
    class Options:
        grid: Grid = Grid()  #: how many cells, and how large
        #: whether the map stays where it is or moves with the tool (section 4.6.2)
        frame: Literal["tool", "world"] = "world"

    def __init__(self, options: Options, context: Context) -> None:
        self._grid = options.grid
        self.reads = ("particle_position",)
        if options.frame == "tool":
            self.reads = (*self.reads, "tool_position", "tool_orientation")

    def compute(
        self,
        particle_position: Tensor,
        tool_position: Tensor | None = None,
        tool_orientation: Tensor | None = None,
    ) -> dict[str, Tensor]:
        seen = particle_position
        if tool_position is not None and tool_orientation is not None:
            seen = in_tool_frame(seen, tool_position, tool_orientation)
        occupied = density(seen, self._grid) > 0
        return {"occupied_cells": occupied.float().sum(dim=(1, 2))}
