"""Rollouts: what learners, curricula and initial states learn from."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from torch import Tensor


@dataclass(repr=False)
class Rollout:
    """T decisions of N worlds, time first. ``values`` and ``returns`` are the learner's to fill."""

    observations: dict[str, Tensor]  #: each (T, N, …), before the action
    last_observations: dict[str, Tensor]  #: each (N, …), after the last step
    actions: Tensor  #: (T, N, A)
    log_probs: Tensor  #: (T, N)
    rewards: Tensor  #: (T, N)
    terminated: Tensor  #: (T, N) bool: the episode ended here and nothing follows
    truncated: Tensor  #: (T, N) bool: the episode was cut here; ``final_values`` is the rest
    failed: Tensor  #: (T, N) bool: terminated by a failure
    final_values: Tensor  #: (T, N) value of the state after a truncated step, 0 elsewhere
    episode_returns: Tensor  #: (T, N) sum of the episode's rewards up to and with this step
    fields: dict[str, Tensor]  #: the ``rollout_fields``, before the action, (T, N, …)
    values: Tensor | None = None  #: (T, N)
    returns: Tensor | None = None  #: (T, N)
    #: Fields of the states reached, before ended worlds begin anew, (T, N, …).
    next_fields: dict[str, Tensor] = field(default_factory=dict)

    @property
    def ended(self) -> Tensor:
        """(T, N) bool: terminated or truncated."""
        return self.terminated | self.truncated

    def __repr__(self) -> str:
        steps, worlds = self.rewards.shape
        sees = ", ".join(f"{name} {list(o.shape)}" for name, o in self.observations.items())
        return (
            f"Rollout({steps} decisions of {worlds} worlds on {self.rewards.device}; {sees}; actions "
            f"{list(self.actions.shape)})"
        )
