"""Rewards and terminations (sections 4 and 6, eq. 2 to 8). All arguments are (N, …)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context
from understudy.task.terms import ranges
from understudy_tensors.limits import DEGREES, limits
from understudy_tensors.rotations import wrapped


@limits(alpha=(0, 1e6))
def pose(
    joint_coordinates: Tensor,
    reference_joint_coordinates: Tensor,
    *,
    alpha: float = 1.0,  #: α^p, 1/rad²: factor of the squared angles (eq. 3)
) -> Tensor:
    """r^p = exp(-α^p Σ_j d(q_j, q̂_j)²) (eq. 3), d the angular difference."""
    away = wrapped(joint_coordinates - reference_joint_coordinates)
    return torch.exp(-alpha * away.square().sum(dim=1))


@limits(alpha=(0, 1e6))
def velocity(
    joint_velocities: Tensor,
    reference_joint_velocities: Tensor,
    *,
    alpha: float = 10.0,  #: α^v, s²/rad²: factor of the squared velocities (eq. 3)
) -> Tensor:
    """r^v = exp(-α^v Σ_j (q̇_j - q̇̂_j)²) (eq. 3)."""
    return torch.exp(-alpha * (joint_velocities - reference_joint_velocities).square().sum(dim=1))


@limits(scale=(0, 1e6), until=(0, 1))
def steering(
    torso_velocity: Tensor,
    reference_torso_velocity: Tensor,
    difficulty: Tensor | None = None,
    *,
    scale: float = 10.0,  #: s²/m², factor of the squared difference of velocities (eq. 4)
    #: difficulty from which on it no longer counts; null is never
    until: float | None = None,
) -> Tensor:
    """exp(-10 Σ_i (v_i - v̂_i)²) (eq. 4, weight 0.5): the torso moves in the world as the reference does.

    With `until` it is 0 once the curriculum's difficulty has reached it: the walk's first stage.
    """
    value = torch.exp(-scale * (torso_velocity - reference_torso_velocity).square().sum(dim=1))
    return _when(value, difficulty, None, until)


class Approach:
    """1 / (1 + exp(10 V^walk)) (eq. 5, weight 0.1), V^walk = (D_{t+1} - D_t) / δt the speed at which the
    horizontal distance to the target grows.

    The target is the one of before the decision, since a new one is at another distance. With
    ``since`` it is 0 until the curriculum's difficulty has reached it: the walk's second stage.
    """

    @dataclass(frozen=True)
    class Options:
        scale: float = 10.0  #: s/m, above 0: factor of V^walk (eq. 5)
        since: float | None = None  #: difficulty from which on it counts; null is always

        def __post_init__(self) -> None:
            check_range(self, "scale", above=0)
            check_range(self, "since", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._dt = options, context.control_dt * context.decision

    def __call__(
        self,
        torso_position: Tensor,
        previous_torso_position: Tensor,
        previous_target: Tensor,
        difficulty: Tensor,
    ) -> Tensor:
        after = (previous_target - torso_position[:, :2]).norm(dim=1)
        before = (previous_target - previous_torso_position[:, :2]).norm(dim=1)
        value = torch.sigmoid(-self._options.scale * (after - before) / self._dt)
        return _when(value, difficulty, self._options.since, None)


def _when(
    value: Tensor, difficulty: Tensor | None, since: float | None, until: float | None
) -> Tensor:
    """`value` where the difficulty is at least `since` and below `until`; else 0."""
    if difficulty is None:
        return value
    if since is not None:
        value = torch.where(difficulty >= since, value, 0.0)
    if until is not None:
        value = torch.where(difficulty < until, value, 0.0)
    return value


@limits(scale=(0, 1e6))
def turning(
    torso_angles: Tensor,
    reference_torso_angles: Tensor,
    *,
    scale: float = 10.0,  #: 1/rad², factor of the summed squared angles (eq. 6)
) -> Tensor:
    """exp(-10 Σ_i d(θ_i, θ̂_i)²) (eq. 6, weight 0.1), θ the torso's pitch, yaw and roll."""
    away = wrapped(torso_angles - reference_torso_angles)
    return torch.exp(-scale * away.square().sum(dim=1))


@ranges(-math.inf, math.inf)
class Nearing:
    """-V^sit = -(D_{t+1} - D_t) / δt (eq. 7, weight 0.5): how fast the pelvis comes to the seat, m/s."""

    def __init__(self, options: None, context: Context) -> None:
        self._dt = context.control_dt * context.decision

    def __call__(self, seat_distance: Tensor, previous_seat_distance: Tensor) -> Tensor:
        return (previous_seat_distance - seat_distance) / self._dt


@ranges(-math.inf, math.inf)
class SitDown:
    """r^meta (eq. 8): 1 while it sits (:class:`~understudy_sitting.state.Seat`), else 0.5 (-V^sit)."""

    @dataclass(frozen=True)
    class Options:
        seated: float = 1.0  #: reward of a decision that ends seated
        nearing: float = 0.5  #: s/m: what coming nearer by 1 m/s is worth (eq. 8)

        def __post_init__(self) -> None:
            check_range(self, "seated", "nearing", least=-1e6)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._dt = options, context.control_dt * context.decision

    def __call__(
        self, seated: Tensor, seat_distance: Tensor, previous_seat_distance: Tensor
    ) -> Tensor:
        nearing = (previous_seat_distance - seat_distance) / self._dt
        return torch.where(seated > 0, self._options.seated, self._options.nearing * nearing)


@limits(height=(0, 1e3))
def low(
    torso_position: Tensor,
    *,
    height: float = 0.78,  #: m above the floor, least height of the torso (section 6)
) -> Tensor:
    """The torso is lower than `height` m (section 6: 0.78 for walk and turn, 0.54 for sit)."""
    return torso_position[:, 2] < height


@limits(degrees=DEGREES)
def off_course(
    torso_angles: Tensor,
    reference_torso_angles: Tensor,
    *,
    degrees: float = 45.0,  #: degrees, greatest difference of yaw (section 6)
) -> Tensor:
    """The torso's yaw differs from the reference's by more than `degrees` (section 6, turn)."""
    away = wrapped(torso_angles[:, 1] - reference_torso_angles[:, 1])
    return away.abs() > math.radians(degrees)
