"""Distances of segments from boxes, batched, and the barrier that keeps shapes apart."""

from __future__ import annotations

import math

import torch
from torch import Tensor

#: m: below this clearance the barrier goes on as a straight line, so that it and its slope stay finite.
LEAST = 1e-5
_TINY = 1e-12


def clamped_log(z: Tensor, limit: float, least: float = LEAST) -> Tensor:
    """Eq. 5.7: a barrier that is 0 from the clearance `limit` up and grows without end towards 0.

    -(z - z0)²/z · ln(z/z0) for 0 < z < z0. The thesis calls z a depth of penetration; a barrier that is 0
    above 1 mm and infinite at 0 is one of a clearance. Below `least` it continues as its tangent there.

    Parameters
    ----------
    z
        (…) m.
    limit
        z0, m.
    least
        m.
    """
    inside = z.clamp(least, limit)
    value = -((inside - limit) ** 2) / inside * torch.log(inside / limit)
    ratio = least - limit
    slope = (
        -(2.0 * ratio / least - ratio**2 / least**2) * math.log(least / limit) - ratio**2 / least**2
    )
    return value + slope * (z - least).clamp(max=0.0)


def box_distance(
    ends: Tensor, middles: Tensor, turns: Tensor, sizes: Tensor, samples: int = 41
) -> Tensor:
    """(…) m, negative inside: of the segment `ends` (…, 2, 3), at so many points, from a box.

    Parameters
    ----------
    ends
        (…, 2, 3).
    middles, turns
        (…, 3) and (…, 3, 3), the box's axes as columns.
    sizes
        (…, 3), its half sizes.
    """
    shares = torch.linspace(0.0, 1.0, samples, dtype=ends.dtype)
    points = ends[..., :1, :] + shares[:, None] * (ends[..., 1:, :] - ends[..., :1, :])
    local = (points - middles[..., None, :]) @ turns
    beyond = local.abs() - sizes[..., None, :]
    outside = _length(beyond.clamp(min=0.0))
    inside = beyond.amax(-1).clamp(max=0.0)
    return (outside + inside).amin(-1)


def _length(vector: Tensor) -> Tensor:
    """(…): with a gradient of 0 at 0, where there is none."""
    return ((vector * vector).sum(-1) + _TINY * _TINY).sqrt()
