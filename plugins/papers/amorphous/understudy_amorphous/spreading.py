"""Spreading: a tight pile is spread over the table (section 4.2). Heights are along z, y in the paper."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from understudy.task.terms import ranges
from understudy_tensors.limits import limits


@ranges(-math.inf, math.inf)
def newly_occupied(occupied_cells: Tensor, previous_occupied_cells: Tensor) -> Tensor:
    """r_hc (eq. 7): how many more cells of a map have material."""
    return occupied_cells - previous_occupied_cells


@ranges(-math.inf, math.inf)
def lowered(particle_position: Tensor, previous_particle_position: Tensor) -> Tensor:
    """r_h (eq. 8): by how much the mean height of the particles fell, m."""
    return (previous_particle_position[..., 2] - particle_position[..., 2]).mean(dim=1)


@limits(c_min=(-1e3, 1e3), k=(-1e6, 1e6))
@ranges(-math.inf, math.inf)
def movement(
    particle_position: Tensor,
    previous_particle_position: Tensor,
    *,
    #: m, the height above which a particle is not yet spread (Table 2)
    c_min: float = 0.2,
    #: weight of the particles that lie on the table; Table 2 has none, 0.1 is ours
    k: float = 0.1,
) -> Tensor:
    """r_m (eq. 9): the mean motion of the particles higher than `c_min` (m), less `k` times that of
    the others, which lie on the table; m. Table 2 has no `k`."""
    moved = (particle_position - previous_particle_position).norm(dim=2)
    return torch.where(particle_position[..., 2] > c_min, moved, -k * moved).mean(dim=1)


@limits(c_rad=(0, 1e3))
@ranges(-math.inf, 0.0)
def outliers(
    particle_position: Tensor,
    *,
    #: m from the middle of the table (Table 2)
    c_rad: float = 3.2,
) -> Tensor:
    """r_o (eq. 10): minus the sum of how far particles are beyond `c_rad` (m) from the middle of the
    table, seen from above."""
    return -(particle_position[..., :2].norm(dim=2) - c_rad).clamp(min=0.0).sum(dim=1)
