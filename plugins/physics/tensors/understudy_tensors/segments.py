"""Distances of points and segments, batched.

The nearest places on two segments are found without gradients and then held: moving them there changes the
distance by nothing, so its gradients are right.
"""

from __future__ import annotations

import torch
from torch import Tensor

__all__ = ["at", "nearest_places", "place_on_segment", "segment_distance"]

_TINY = 1e-12


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


def _length(vector: Tensor) -> Tensor:
    """(…): with a gradient of 0 at 0, where there is none."""
    return ((vector * vector).sum(-1) + _TINY * _TINY).sqrt()
