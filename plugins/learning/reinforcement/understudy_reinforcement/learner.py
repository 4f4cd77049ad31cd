"""Learners, which improve a policy from rollouts."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping

from torch import Tensor

from understudy.task import Rollout, State

__all__ = ["Learner"]


class Learner(ABC):
    """Improves a policy from rollouts. Built with ``(options, context, policy)``."""

    #: T, the decisions per world and iteration.
    rollout_steps: int
    #: Fields of the states, each (T, N, …), that rollouts are to bring beside the observations:
    #: before the action, and as it left them, before the next episode begins.
    rollout_fields: tuple[str, ...] = ()
    next_fields: tuple[str, ...] = ()
    #: Called once with what led to the first non-finite step, so that it can be replayed.
    on_fault: Callable[[Mapping[str, Tensor]], None] | None = None

    @abstractmethod
    def update(self, rollout: Rollout) -> dict[str, float]:
        """Improve the policy once; sets the rollout's ``values`` and ``returns``, and returns metrics.

        A step whose loss or gradient is not finite must leave the weights as they were and count
        in the metric ``skipped_steps``.
        """

    @abstractmethod
    def state_dict(self) -> State: ...

    @abstractmethod
    def load_state_dict(self, state: State) -> None: ...
