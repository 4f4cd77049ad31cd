"""How curricula judge the episodes that ended in a rollout."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy import distributed
from understudy.task import State

__all__ = ["Judged", "totals"]


def totals(*values: Tensor) -> list[float]:
    """The sum of each of `values`, of any shape, over all processes of the training."""
    return distributed.total(torch.stack([value.double().sum() for value in values])).tolist()


class Judged:
    """Whether episodes go well: `episodes` or more that ended are judged together, by whether the mean of their
    scores, the metric `name`, reaches `threshold`."""

    def __init__(self, episodes: int, name: str, threshold: float) -> None:
        self._least, self._ended, self._total = episodes, 0, 0.0
        self._name, self._threshold = name, threshold

    def digest(self, counted: Tensor, score: Tensor) -> tuple[dict[str, float], bool]:
        """Add the `score` (T, N) of those that are `counted` (T, N) bool. Once there are enough, the metric and whether it
        reaches the threshold, after which they are forgotten; else no metric, and False."""
        ended, total = totals(counted, torch.where(counted, score, 0.0))
        self._ended, self._total = self._ended + int(ended), self._total + total
        if self._ended < self._least:
            return {}, False
        mean = self._total / self._ended
        self._ended, self._total = 0, 0.0
        return {self._name: mean}, mean >= self._threshold

    def state_dict(self) -> State:
        return {"ended": self._ended, "total": self._total}

    def load_state_dict(self, state: State) -> None:
        self._ended, self._total = state["ended"], state["total"]
