"""Laws of the quaternion functions, checked on random rotations and against scipy."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy_tensors import rotations as rot

SHAPES = st.sampled_from([(), (1,), (5,), (2, 3)])
CASES = settings(max_examples=30, deadline=None)


@st.composite
def quaternions(draw: st.DrawFn, count: int = 1) -> list[Tensor]:
    """`count` batches of one shape, uniform on the sphere, float64."""
    shape, seed = draw(SHAPES), draw(st.integers(0, 2**31))
    generator = torch.Generator().manual_seed(seed)
    return [
        rot.normalize(torch.randn(*shape, 4, generator=generator, dtype=torch.float64))
        for _ in range(count)
    ]


def scipy_of(q: Tensor) -> Rotation:
    return Rotation.from_quat(q.reshape(-1, 4).numpy(), scalar_first=True)


def same_rotation(a: Tensor, b: Tensor, tolerance: float = 1e-12) -> bool:
    return bool((rot.angle_between(a, b) < tolerance).all())


@CASES
@given(quaternions(3))
def test_multiplication_is_composition(qs: list[Tensor]) -> None:
    a, b, c = qs
    assert torch.allclose(rot.multiply(rot.multiply(a, b), c), rot.multiply(a, rot.multiply(b, c)))
    expected = (scipy_of(a) * scipy_of(b)).as_matrix()
    np.testing.assert_allclose(
        rot.to_matrix(rot.multiply(a, b)).reshape(-1, 3, 3).numpy(), expected, atol=1e-12
    )
    v = c[..., :3]
    assert torch.allclose(rot.rotate(rot.multiply(a, b), v), rot.rotate(a, rot.rotate(b, v)))
    assert torch.allclose(rot.inverse_rotate(a, rot.rotate(a, v)), v)


@CASES
@given(quaternions(2))
def test_agrees_with_scipy(qs: list[Tensor]) -> None:
    q, other = qs
    reference = scipy_of(q)
    np.testing.assert_allclose(
        rot.to_exponential_map(q).reshape(-1, 3).numpy(), reference.as_rotvec(), atol=1e-12
    )
    np.testing.assert_allclose(
        rot.angle_between(q, other).reshape(-1).numpy(),
        (reference.inv() * scipy_of(other)).magnitude(),
        atol=1e-12,
    )
    axes = rot.tangent_normal(q).reshape(-1, 6).numpy()
    np.testing.assert_allclose(axes[:, :3], reference.apply([1.0, 0.0, 0.0]), atol=1e-12)
    np.testing.assert_allclose(axes[:, 3:], reference.apply([0.0, 0.0, 1.0]), atol=1e-12)


@CASES
@given(quaternions(1))
def test_exponential_map_round_trip(qs: list[Tensor]) -> None:
    (q,) = qs
    v = rot.to_exponential_map(q)
    assert (torch.linalg.vector_norm(v, dim=-1) <= math.pi + 1e-12).all()
    assert torch.allclose(rot.from_exponential_map(v), rot.canonical(q))
    assert torch.equal(rot.to_exponential_map(-q), v)


@pytest.mark.parametrize("dtype", [torch.float32, torch.float64])
@pytest.mark.parametrize("size", [0.0, 1e-30, 1e-18, 1e-12, 1e-8, 1e-4, 1e-2, 1.0, 3.1])
def test_small_angles_keep_relative_accuracy(dtype: torch.dtype, size: float) -> None:
    v = size * torch.tensor([[2.0, -3.0, 6.0]], dtype=dtype) / 7.0
    q = rot.from_exponential_map(v)
    tolerance = 8 * torch.finfo(dtype).eps
    assert torch.allclose(rot.to_exponential_map(q), v, rtol=tolerance, atol=0.0)
    one = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=dtype)
    if size >= 1e-12:
        angle = torch.linalg.vector_norm(v, dim=-1)
        assert torch.allclose(rot.angle_between(one, q), angle, rtol=tolerance, atol=0.0)


def test_half_turn_is_a_half_turn() -> None:
    q = torch.tensor([0.0, 0.0, -1.0, 0.0])
    assert torch.linalg.vector_norm(rot.to_exponential_map(q)).item() == pytest.approx(math.pi)


@CASES
@given(quaternions(2), st.floats(0.0, 1.0))
def test_slerp_has_constant_speed_on_the_shorter_arc(qs: list[Tensor], t: float) -> None:
    a, b = qs
    whole = rot.angle_between(a, b)
    at = rot.slerp(a, b, torch.full_like(whole, t))
    assert torch.allclose(rot.angle_between(a, at), t * whole, atol=1e-9)
    assert torch.allclose(rot.angle_between(at, b), (1 - t) * whole, atol=1e-9)
    assert same_rotation(rot.slerp(a, -b, torch.full_like(whole, t)), at, 1e-9)


@CASES
@given(quaternions(2))
def test_angular_velocity_carries_one_rotation_to_the_other(qs: list[Tensor]) -> None:
    a, b = qs
    velocity = rot.angular_velocity(a, b, 0.02)
    assert same_rotation(rot.multiply(rot.from_exponential_map(0.02 * velocity), a), b, 1e-9)


@CASES
@given(quaternions(1), st.floats(-3.0, 3.0))
def test_heading_turns_with_the_world(qs: list[Tensor], yaw: float) -> None:
    (q,) = qs
    forward = rot.rotate(q, torch.tensor([1.0, 0.0, 0.0], dtype=q.dtype))
    assert torch.allclose(rot.heading(q), torch.atan2(forward[..., 1], forward[..., 0]))
    turn = rot.from_heading(torch.full_like(q[..., 0], yaw))
    turned = rot.multiply(turn, rot.heading_rotation(q))
    assert same_rotation(rot.heading_rotation(rot.multiply(turn, q)), turned, 1e-6)


@CASES
@given(quaternions(1), st.floats(-3.0, 3.0))
def test_twist_recovers_a_hinge_angle(qs: list[Tensor], angle: float) -> None:
    axis = rot.normalize(qs[0])[..., 1:]
    axis = axis / torch.linalg.vector_norm(axis, dim=-1, keepdim=True)
    angles = torch.full_like(axis[..., 0], angle)
    assert torch.allclose(rot.twist_angle(rot.from_axis_angle(axis, angles), axis), angles)


def test_turned_vectors_are_those_of_the_matrix() -> None:
    chance = torch.Generator().manual_seed(3)
    vectors = torch.randn(5, 7, 3, dtype=torch.float64, generator=chance)
    angle = torch.tensor([0.0, 0.3, -2.0, math.pi, 40.0], dtype=torch.float64)
    before = vectors.clone()
    expected = (rot.turn_matrix(angle)[:, None] @ vectors[..., None]).squeeze(-1)
    torch.testing.assert_close(rot.turned(vectors, angle), expected)
    assert torch.equal(vectors, before)


def test_pitch_yaw_roll() -> None:
    angles = torch.tensor([[0.4, 2.0, -0.3], [-1.2, -3.0, 1.0]], dtype=torch.float64)
    axes = torch.eye(3, dtype=torch.float64)
    pitch, yaw, roll = (
        rot.from_axis_angle(axes[a], angles[:, k]) for k, a in ((0, 1), (1, 2), (2, 0))
    )
    turned = rot.multiply(yaw, rot.multiply(pitch, roll))
    torch.testing.assert_close(rot.pitch_yaw_roll(turned), angles)


def test_turned_flat_is_the_turn_about_z() -> None:
    angle = torch.tensor([0.5, -2.0, 3.0], dtype=torch.float64)
    flat = torch.randn(3, 2, dtype=torch.float64)
    upright = torch.nn.functional.pad(flat, (0, 1))
    expected = rot.rotate(rot.from_heading(angle), upright)[:, :2]
    torch.testing.assert_close(rot.turned_flat(flat, angle), expected)


def test_wrapped_is_the_same_angle_within_half_a_turn() -> None:
    angle = torch.tensor([0.0, 3.0, 4.0, -4.0, 100.0], dtype=torch.float64)
    found = rot.wrapped(angle)
    assert ((found >= -math.pi) & (found < math.pi)).all()
    torch.testing.assert_close(found.cos(), angle.cos())
    torch.testing.assert_close(found.sin(), angle.sin())


def test_gradients_where_constants_were_made_without() -> None:
    """As where somebody played before, in this process, in inference mode."""
    cached = [one for one in vars(rot).values() if hasattr(one, "cache_clear")]
    q = torch.tensor([[1.0, 0.0, 0.0, 0.0]])

    def turned(of: Tensor) -> Tensor:
        both = rot.multiply(rot.conjugate(of), of)
        heading, normal = rot.heading(both), rot.tangent_normal(of)
        return rot.to_matrix(both).sum() + heading.sum() + normal.sum()

    for one in cached:
        one.cache_clear()
    with torch.inference_mode():
        turned(q)
    assert all(one.cache_info().currsize for one in cached)
    turned(q.requires_grad_()).backward()
    assert q.grad is not None
