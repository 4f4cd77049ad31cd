"""What curricula make of the episodes that ended in a rollout."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy import distributed
from understudy.task import State

__all__ = ["Judged", "totals"]


def totals(*values: Tensor) -> list[float]:
    """The sum of each of `values`, of any shape, over all processes that learn together."""
    return distributed.total(torch.stack([value.double().sum() for value in values])).tolist()


class Judged:
    """The scores of episodes that ended, `episodes` or more of which are judged together."""

    def __init__(self, episodes: int) -> None:
        self._least, self._ended, self._total = episodes, 0, 0.0

    def digest(self, counted: Tensor, score: Tensor) -> float | None:
        """With the `score` (T, N) of the `counted` (T, N) bool ones: their mean, once there are enough,
        which then count no more; else None."""
        ended, total = totals(counted, torch.where(counted, score, 0.0))
        self._ended, self._total = self._ended + int(ended), self._total + total
        if self._ended < self._least:
            return None
        mean = self._total / self._ended
        self._ended, self._total = 0, 0.0
        return mean

    def state_dict(self) -> State:
        return {"ended": self._ended, "total": self._total}

    def load_state_dict(self, state: State) -> None:
        self._ended, self._total = state["ended"], state["total"]
