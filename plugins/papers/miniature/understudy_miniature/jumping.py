"""A point that runs at a bar and jumps over it, pushing only while it stands on the floor."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Actuation, Context, Encoder, Fields, box
from understudy.task.terms import ranges
from understudy_tensors.limits import limits


class Bar(Fields):
    """The bar at 0 along the first axis; its height grows with the difficulty.

    ``crossing`` is 1 in the control period in which the point passes it, ``clearance`` (m) how far
    above the bar the point is, and ``effort`` the action's mean square.
    """

    reads = ("position", "previous_position", "difficulty", "action")
    provides = {"bar_height": (), "clearance": (), "crossing": (), "effort": ()}

    @dataclass(frozen=True)
    class Options:
        low: float = 0.1  #: m, height of the bar at difficulty 0
        high: float = 0.5  #: m, height of the bar at difficulty 1

        def __post_init__(self) -> None:
            check_range(self, "low", most=1e3)
            check_range(self, "low", "high", above=0)
            check_range(self, "high", least=-1e3, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options

    def compute(
        self, position: Tensor, previous_position: Tensor, difficulty: Tensor, action: Tensor
    ) -> dict[str, Tensor]:
        low, high = self._options.low, self._options.high
        height = low + (high - low) * difficulty
        crossing = (previous_position[:, 0] < 0) & (position[:, 0] >= 0)
        return {
            "bar_height": height,
            "clearance": position[:, 1] - height,
            "crossing": crossing.float(),
            "effort": torch.tanh(action).square().mean(dim=1),
        }


class Run(Encoder):
    """Where the point is, its velocity, and how high the bar is, (N, 5)."""

    reads = ("position", "velocity", "bar_height")
    shape = (5,)

    def __init__(self, options: None, context: Context) -> None:
        pass

    def encode(self, position: Tensor, velocity: Tensor, bar_height: Tensor) -> Tensor:
        return torch.cat([position, velocity, bar_height.unsqueeze(1)], dim=1)


class Legs(Actuation):
    """The action, squashed, is the push against the floor, which falls off with the height above it.

    It is computed anew in every physics step, since the point leaves the floor within a few.
    """

    reads = ("position",)
    every = "substep"
    action_space = box(2)

    @dataclass(frozen=True)
    class Options:
        strength: float = 90.0  #: N, largest force along each axis
        length: float = 0.15  #: m above the floor, from which on there is nothing to push against

        def __post_init__(self) -> None:
            check_range(self, "length", most=1e3)
            check_range(self, "strength", "length", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options

    def control(self, action: Tensor, position: Tensor) -> Tensor:
        contact = (1 - position[:, 1:] / self._options.length).clamp(min=0)
        return self._options.strength * torch.tanh(action) * contact


def cleared(passed: Tensor, bar_clearance: Tensor) -> Tensor:
    """The point has passed the bar above it."""
    return (passed != 0) & (bar_clearance > 0)


def knocked(passed: Tensor, bar_clearance: Tensor) -> Tensor:
    """The point has run into the bar."""
    return (passed != 0) & (bar_clearance <= 0)


def height(passed: Tensor, bar_clearance: Tensor) -> Tensor:
    """The clearance at the bar, m; -1 where the point has not come so far."""
    return torch.where(passed != 0, bar_clearance, -1.0)


@limits(scale=(1e-9, 1e3))
def completion(
    passed: Tensor,
    bar_clearance: Tensor,
    mean_effort: Tensor,
    *,
    #: m, above 0, by which a bar that is missed costs a factor e
    scale: float = 0.2,
) -> Tensor:
    """Once, at the bar: how nearly it was cleared, times how naturally, which is with little effort:

    r = exp(min(0, clearance) / scale) · exp(-mean effort)
    """
    return passed * torch.exp(bar_clearance.clamp(max=0) / scale - mean_effort)


@limits(scale=(-1e6, 1e6))
@ranges(-math.inf, math.inf)
def forward(
    velocity: Tensor,
    *,
    #: s/m: what a velocity of 1 m/s is worth
    scale: float = 0.1,
) -> Tensor:
    """Velocity along the first axis, times `scale` (s/m)."""
    return scale * velocity[:, 0]
