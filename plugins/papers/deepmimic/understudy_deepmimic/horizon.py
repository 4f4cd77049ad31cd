"""How long an episode of difficulty z is, and what its return is worth (thesis, section 6.4.2)."""

from __future__ import annotations

from typing import TypeVar

from torch import Tensor

from understudy.task import Context

Number = TypeVar("Number", float, Tensor)


def horizon(difficulty: Number) -> Number:
    """T(z) in s. The thesis has 30 + 570 z control steps of 1/30 s."""
    return 1.0 + 19.0 * difficulty


class Horizon:
    """The episode has lasted T(z); to be used with ``outcome: truncation``."""

    def __init__(self, options: None, context: Context) -> None:
        self._dt = context.control_dt

    def __call__(self, episode_time: Tensor, difficulty: Tensor) -> Tensor:
        return episode_time >= horizon(difficulty) - 0.5 * self._dt


class NormalisedReturn:
    """Summed over an episode, Σ r_t / T(z) with T(z) in decisions: the first factor of eq. 6.5.

    An episode that ends early has no reward from there on. The value is 1 if the character was like its
    reference for all of T(z). To be used with ``reduce: sum``.
    """

    def __init__(self, options: None, context: Context) -> None:
        self._decision = context.control_dt * context.decision

    def __call__(self, reward: Tensor, difficulty: Tensor) -> Tensor:
        return reward * self._decision / horizon(difficulty)
