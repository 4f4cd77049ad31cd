"""Throws: with which velocity the sticks let go of an object, so that it lands at its goal (thesis, section 5.7.2).

The object flies as a projectile, without drag. m, s; in the world.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

__all__ = ["Throw", "throw"]

GRAVITY = 9.81
#: s of the swing, of constant acceleration; in which the sticks stop after it; in which they open.
SWING, STOP, OPENING = 0.2, 0.1, 0.06
#: m: how high the swing begins above where the object lay; m/s upwards at its end.
LIFT, UP = 0.06, 0.5


@dataclass(frozen=True)
class Throw:
    """A swing along a straight line, from rest, and the flight after it."""

    begin: Tensor  #: (3,) m, of the object
    velocity: Tensor  #: (3,) m/s, as it is let go
    seconds: float  #: s of its flight

    @property
    def release(self) -> Tensor:
        """(3,) m: where it is let go."""
        return self.begin + 0.5 * SWING * self.velocity

    def swing(self, times: Tensor) -> Tensor:
        """(n, 3) m: where the tips' middle is at `times` (n,) s after the swing begins, and on until it stops."""
        after = (times - SWING).clamp(0.0, STOP)
        way = torch.where(times < SWING, 0.5 * times.square() / SWING, 0.5 * SWING)
        way = way + after - 0.5 * after.square() / STOP
        return self.begin + way[:, None] * self.velocity

    def flight(self, times: Tensor) -> Tensor:
        """(n, 3) m: where the object is at `times` (n,) s after it is let go; it stays where it lands."""
        time = times.clamp(max=self.seconds)[:, None]
        fall = time.new_tensor((0.0, 0.0, -0.5 * GRAVITY)) * time.square()
        return self.release + time * self.velocity + fall


def throw(start: Tensor, goal: Tensor) -> Throw:
    """From `start` to `goal`, both (3,) m, of the object's middle."""
    begin = start + start.new_tensor((0.0, 0.0, LIFT))
    drop = float(begin[2] - goal[2]) + 0.5 * SWING * UP
    seconds = (UP + math.sqrt(UP * UP + 2.0 * GRAVITY * drop)) / GRAVITY
    velocity = (goal - begin) / (seconds + 0.5 * SWING)
    velocity[2] = UP
    return Throw(begin, velocity, seconds)
