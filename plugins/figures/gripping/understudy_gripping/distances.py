"""Distances of segments, points and boxes, batched, and the barrier that keeps shapes apart.

The places on two segments that are nearest to one another are found without gradients and then held: there
moving them changes nothing, so the gradients are those of the distance.
"""

from __future__ import annotations

import math

import torch
from torch import Tensor

__all__ = ["at", "place_on_segment"]

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


def place_on_segment(point: Tensor, ends: Tensor) -> Tensor:
    """(…) in [0, 1]: where on the segment `ends` (…, 2, 3) it is nearest to `point` (…, 3)."""
    start, along = ends[..., 0, :], ends[..., 1, :] - ends[..., 0, :]
    square = (along * along).sum(-1).clamp(min=_TINY)
    return (((point - start) * along).sum(-1) / square).clamp(0.0, 1.0)


def at(ends: Tensor, place: Tensor) -> Tensor:
    """(…, 3): the point at `place` (…) of the segment `ends` (…, 2, 3)."""
    return ends[..., 0, :] + place[..., None] * (ends[..., 1, :] - ends[..., 0, :])


def segment_distance(first: Tensor, second: Tensor) -> Tensor:
    """(…) m between the segments (…, 2, 3)."""
    with torch.no_grad():
        on_first, on_second = nearest_places(first, second)
    return _length(at(first, on_first) - at(second, on_second))


def nearest_places(first: Tensor, second: Tensor) -> tuple[Tensor, Tensor]:
    """(…) in [0, 1] on each: where the segments (…, 2, 3) are nearest to one another (Ericson, Real-Time
    Collision Detection, section 5.1.9)."""
    u, v = first[..., 1, :] - first[..., 0, :], second[..., 1, :] - second[..., 0, :]
    w = first[..., 0, :] - second[..., 0, :]
    a, b, c = ((x * y).sum(-1) for x, y in ((u, u), (u, v), (v, v)))
    d, e = (u * w).sum(-1), (v * w).sum(-1)
    denominator = (a * c - b * b).clamp(min=_TINY)
    s = ((b * e - c * d) / denominator).clamp(0.0, 1.0)
    t = ((b * s + e) / c.clamp(min=_TINY)).clamp(0.0, 1.0)
    s = ((b * t - d) / a.clamp(min=_TINY)).clamp(0.0, 1.0)
    return s, t


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
