"""Rotations as unit quaternions, batched in torch.

A quaternion is ``(w, x, y, z)`` in the last dimension; any leading shape, any floating dtype, any
device. ``q`` maps vectors of the rotated frame to the frame it is given in, so ``multiply(a, b)``
applies ``b`` first. ``q`` and ``-q`` are the same rotation; every function treats them alike unless
it says otherwise. Angles are radians.

Formulas: Sola, "Quaternion kinematics for the error-state Kalman filter", 2017; the logarithm near
zero and near a half turn uses ``atan2``, which keeps full relative accuracy in float32. The angle
between two is that of Kahan, "How futile are mindless assessments of roundoff", 2006, section 12.
"""

from __future__ import annotations

import math
from functools import lru_cache

import torch
from torch import Tensor

__all__ = [
    "angle_between",
    "angular_velocity",
    "canonical",
    "conjugate",
    "from_axis_angle",
    "from_exponential_map",
    "from_heading",
    "heading",
    "inverse_rotate",
    "multiply",
    "normalize",
    "pitch_yaw_roll",
    "rotate",
    "slerp",
    "tangent_normal",
    "to_exponential_map",
    "to_matrix",
    "turn_matrix",
    "turned",
    "turned_flat",
    "twist_angle",
    "wrapped",
]

# Below this sine of the half angle, log and its small-angle limit agree to the last bit of float64,
# and the square is still a normal number in float32.
_SMALL = 1e-12


def normalize(q: Tensor) -> Tensor:
    """Scale to unit norm. ``q`` (..., 4), not all zero -> (..., 4)."""
    return q / torch.linalg.vector_norm(q, dim=-1, keepdim=True)


def canonical(q: Tensor) -> Tensor:
    """Of ``q`` and ``-q``, the one with w >= 0. (..., 4) -> (..., 4)."""
    return torch.where(q[..., :1] < 0, -q, q)


def conjugate(q: Tensor) -> Tensor:
    """The inverse rotation of a unit quaternion. (..., 4) -> (..., 4)."""
    return q * _axes((1, -1, -1, -1), q.dtype, q.device)


def multiply(a: Tensor, b: Tensor) -> Tensor:
    """Hamilton product: rotate by ``b``, then by ``a``. (..., 4), (..., 4) broadcast -> (..., 4)."""
    products = (a[..., :, None] * b[..., None, :]).flatten(-2)
    return products @ _hamilton(products.dtype, products.device)


def rotate(q: Tensor, v: Tensor) -> Tensor:
    """Vectors of the rotated frame, seen from outside. (..., 4), (..., 3) broadcast -> (..., 3)."""
    axis = q[..., 1:]
    twice = 2.0 * _cross(axis, v)
    return v + q[..., :1] * twice + _cross(axis, twice)


def inverse_rotate(q: Tensor, v: Tensor) -> Tensor:
    """Vectors from outside, seen in the rotated frame. (..., 4), (..., 3) broadcast -> (..., 3)."""
    axis = q[..., 1:]
    twice = 2.0 * _cross(axis, v)
    return v - q[..., :1] * twice + _cross(axis, twice)


def from_axis_angle(axis: Tensor, angle: Tensor) -> Tensor:
    """Turn by ``angle`` (...) about the unit ``axis`` (..., 3), broadcast -> (..., 4)."""
    half = 0.5 * angle[..., None]
    vector = half.sin() * axis
    return torch.cat((half.cos().expand(*vector.shape[:-1], 1), vector), dim=-1)


def from_exponential_map(v: Tensor) -> Tensor:
    """Turn about ``v`` by its length, |v| of any size. (..., 3) -> (..., 4)."""
    half = 0.5 * torch.linalg.vector_norm(v, dim=-1, keepdim=True)
    return torch.cat((half.cos(), 0.5 * torch.sinc(half / math.pi) * v), dim=-1)


def to_exponential_map(q: Tensor) -> Tensor:
    """The shortest rotation vector, length in [0, pi]. Unit (..., 4) -> (..., 3).

    Continuous everywhere but across half turns, where both signs are the same rotation.
    """
    w, v = q[..., :1], q[..., 1:]
    sine = torch.linalg.vector_norm(v, dim=-1, keepdim=True)
    scale = 2.0 * torch.atan2(sine, w.abs()) / sine.clamp(min=_SMALL)
    scale = torch.where(sine > _SMALL, scale, 2.0)
    return torch.where(w < 0, -scale, scale) * v


def angle_between(a: Tensor, b: Tensor) -> Tensor:
    """Angle of the rotation from ``a`` to ``b``, in [0, pi]. (..., 4), (..., 4) -> (...)."""
    norm = torch.linalg.vector_norm
    difference, total = norm(a - b, dim=-1), norm(a + b, dim=-1)  # swapped where b is -b
    return 4.0 * torch.atan2(torch.minimum(difference, total), torch.maximum(difference, total))


def twist_angle(q: Tensor, axis: Tensor) -> Tensor:
    """Angle in (-pi, pi] of the part of ``q`` about the unit ``axis``: (..., 4), (..., 3) -> (...).

    The swing-twist decomposition: the turn about ``axis`` nearest to ``q``.
    """
    q = canonical(q)
    return 2.0 * torch.atan2((q[..., 1:] * axis).sum(dim=-1), q[..., 0])


def heading(q: Tensor) -> Tensor:
    """Yaw about world z of the rotated x axis, in (-pi, pi]. (..., 4) -> (...).

    Undefined (some finite angle) where the rotated x axis is vertical.
    """
    sine, cosine = (_products(q) @ _heading_of_products(q.dtype, q.device)).unbind(-1)
    return torch.atan2(sine, cosine)


def from_heading(angle: Tensor) -> Tensor:
    """Turn by ``angle`` (...) about world z -> (..., 4)."""
    return _circle(0.5 * angle) @ _axes(((1, 0, 0, 0), (0, 0, 0, 1)), angle.dtype, angle.device)


def turn_matrix(angle: Tensor) -> Tensor:
    """Matrices of the turns by ``angle`` (...) about world z -> (..., 3, 3)."""
    rows = ((1, 0, 0, 0, 1, 0, 0, 0, 0), (0, -1, 0, 1, 0, 0, 0, 0, 0))
    upright = _axes(((0, 0, 0, 0, 0, 0, 0, 0, 1),), angle.dtype, angle.device)
    return (_circle(angle) @ _axes(rows, angle.dtype, angle.device) + upright).unflatten(-1, (3, 3))


def turned(vectors: Tensor, angle: Tensor) -> Tensor:
    """``vectors`` (N, K, 3) turned by ``angle`` (N,) about world z; for many, faster than a matrix."""
    x, y, _ = vectors.unbind(-1)
    cosine, sine = angle.cos().unsqueeze(1), angle.sin().unsqueeze(1)
    result = vectors.clone()
    result[..., 0].mul_(cosine).addcmul_(y, sine, value=-1.0)
    result[..., 1].mul_(cosine).addcmul_(x, sine)
    return result


def turned_flat(vectors: Tensor, angle: Tensor) -> Tensor:
    """``vectors`` (..., 2) turned by ``angle`` (...), to the left where it is positive."""
    sine, cosine = angle.sin(), angle.cos()
    x, y = vectors.unbind(-1)
    return torch.stack([cosine * x - sine * y, sine * x + cosine * y], dim=-1)


def wrapped(angle: Tensor) -> Tensor:
    """The same ``angle`` (...) in [-pi, pi)."""
    return torch.remainder(angle + math.pi, 2 * math.pi) - math.pi


def pitch_yaw_roll(q: Tensor) -> Tensor:
    """(..., 3): the yaw about z, then the pitch about the turned y, then the roll about the turned x that
    make ``q``, in the order of the name. Pitch is within a quarter turn."""
    matrix = to_matrix(q)
    pitch = torch.asin((-matrix[..., 2, 0]).clamp(-1.0, 1.0))
    yaw = torch.atan2(matrix[..., 1, 0], matrix[..., 0, 0])
    roll = torch.atan2(matrix[..., 2, 1], matrix[..., 2, 2])
    return torch.stack([pitch, yaw, roll], dim=-1)


def _circle(angle: Tensor) -> Tensor:
    """Cosine and sine, (...) -> (..., 2)."""
    return torch.stack((angle.cos(), angle.sin()), dim=-1)


# Constants are made once, none of them in inference mode: it would be of no use where gradients are asked for.
@lru_cache
@torch.inference_mode(False)
def _axes(
    rows: tuple[int, ...] | tuple[tuple[int, ...], ...], dtype: torch.dtype, device: torch.device
) -> Tensor:
    """The constant matrix of these rows, or vector of these numbers, made once."""
    return torch.tensor(rows, dtype=dtype, device=device)


def heading_rotation(q: Tensor) -> Tensor:
    """The turn about world z by ``heading(q)``. (..., 4) -> (..., 4)."""
    return from_heading(heading(q))


def slerp(a: Tensor, b: Tensor, t: Tensor) -> Tensor:
    """Constant-speed interpolation along the shorter arc; t (...) = 0 is ``a``, 1 is ``b``."""
    arc = to_exponential_map(multiply(conjugate(a), b))
    return multiply(a, from_exponential_map(t[..., None] * arc))


def angular_velocity(a: Tensor, b: Tensor, dt: Tensor | float) -> Tensor:
    """Constant velocity, rad/s in the outer frame, that turns ``a`` into ``b`` in ``dt`` seconds.

    (..., 4), (..., 4), scalar or broadcastable (..., 1) -> (..., 3). The shorter way round.
    """
    return to_exponential_map(multiply(b, conjugate(a))) / dt


def to_matrix(q: Tensor) -> Tensor:
    """Rotation matrices, columns the rotated axes. Unit (..., 4) -> (..., 3, 3)."""
    return (_products(q) @ _matrix_of_products(q.dtype, q.device)).unflatten(-1, (3, 3))


def tangent_normal(q: Tensor) -> Tensor:
    """The rotated x axis, then the rotated z axis: a continuous observation. (..., 4) -> (..., 6).

    Zhou et al., "On the Continuity of Rotation Representations in Neural Networks", CVPR 2019.
    """
    return _products(q) @ _tangent_normal_of_products(q.dtype, q.device)


def _cross(a: Tensor, b: Tensor) -> Tensor:
    """The cross product with full broadcasting: ``torch.linalg.cross`` wants as many dimensions of both."""
    if a.dim() != b.dim():
        a, b = torch.broadcast_tensors(a, b)
    return torch.linalg.cross(a, b)


def _products(q: Tensor) -> Tensor:
    """All products of two components. (..., 4) -> (..., 16)."""
    return (q[..., :, None] * q[..., None, :]).flatten(-2)


def _table(
    rows: list[list[tuple[int, int, int]]], dtype: torch.dtype, device: torch.device
) -> Tensor:
    """(16, len(rows)): each row's entries (i, j, factor) of products of components."""
    table = torch.zeros(16, len(rows), dtype=dtype)
    for column, terms in enumerate(rows):
        for i, j, factor in terms:
            table[4 * i + j, column] = factor
    return table.to(device)


@lru_cache
@torch.inference_mode(False)
def _hamilton(dtype: torch.dtype, device: torch.device) -> Tensor:
    """(16, 4): the product's components are linear in the products of components."""
    w, x, y, z = range(4)
    rows = [
        [(w, w, 1), (x, x, -1), (y, y, -1), (z, z, -1)],
        [(w, x, 1), (x, w, 1), (y, z, 1), (z, y, -1)],
        [(w, y, 1), (y, w, 1), (z, x, 1), (x, z, -1)],
        [(w, z, 1), (z, w, 1), (x, y, 1), (y, x, -1)],
    ]
    return _table(rows, dtype, device)


@lru_cache
@torch.inference_mode(False)
def _heading_of_products(dtype: torch.dtype, device: torch.device) -> Tensor:
    """(16, 2): y and x of the rotated x axis."""
    return _matrix_of_products(dtype, device)[:, [3, 0]].contiguous()


@lru_cache
@torch.inference_mode(False)
def _matrix_of_products(dtype: torch.dtype, device: torch.device) -> Tensor:
    """(16, 9): the row-major rotation matrix is linear in the products of components."""
    w, x, y, z = range(4)
    rows = [
        [(w, w, 1), (x, x, 1), (y, y, -1), (z, z, -1)],
        [(x, y, 2), (w, z, -2)],
        [(x, z, 2), (w, y, 2)],
        [(x, y, 2), (w, z, 2)],
        [(w, w, 1), (x, x, -1), (y, y, 1), (z, z, -1)],
        [(y, z, 2), (w, x, -2)],
        [(x, z, 2), (w, y, -2)],
        [(y, z, 2), (w, x, 2)],
        [(w, w, 1), (x, x, -1), (y, y, -1), (z, z, 1)],
    ]
    return _table(rows, dtype, device)


@lru_cache
@torch.inference_mode(False)
def _tangent_normal_of_products(dtype: torch.dtype, device: torch.device) -> Tensor:
    """(16, 6): columns 0 and 2 of the matrix."""
    return _matrix_of_products(dtype, device)[:, [0, 3, 6, 2, 5, 8]].contiguous()
