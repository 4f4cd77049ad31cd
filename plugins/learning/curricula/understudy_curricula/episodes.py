"""How curricula judge the episodes that ended in a rollout."""

from __future__ import annotations

import math
from typing import Any

import torch
from torch import Tensor

from understudy import distributed
from understudy.errors import ConfigError
from understudy.task import Context, State

__all__ = ["Judged", "first_difficulty", "mark_worlds", "number_in", "totals"]


def totals(*values: Tensor) -> list[float]:
    """The sum of each of `values`, of any shape, over all processes of the training."""
    return distributed.total(torch.stack([value.double().sum() for value in values])).tolist()


def first_difficulty(start: float, context: Context) -> float:
    """The difficulty with which a training's curriculum begins at `start`, and an evaluation's at the task's own.

    Raises
    ------
    ConfigError
        if that is less than where the training begins.
    """
    if context.evaluating:
        return context.difficulty
    if start > context.difficulty:
        raise ConfigError(
            f"curriculum.start={start:g} is beyond difficulty={context.difficulty:g}, to which the training leads. Begin with "
            "that at most."
        )
    return start


def number_in(state: State, name: str, least: float = 0.0, most: float = math.inf) -> Any:
    """The number `name` of a checkpoint's `state`; a ValueError if it is not between `least` and `most`."""
    value = state[name]
    if isinstance(value, bool) or not isinstance(value, (int, float)) or not least <= value <= most:
        raise ValueError(f"'curriculum/{name}' is {value}, and not between {least:g} and {most:g}")
    return value


def mark_worlds(marks: Tensor, state: State, name: str) -> None:
    """Mark, in `marks` (N,) bool, the worlds that a checkpoint's `state` lists as `name`; there may be fewer now."""
    worlds = torch.tensor(state[name], dtype=torch.long, device=marks.device)
    if worlds.dim() != 1 or bool((worlds < 0).any()):
        raise ValueError(f"'curriculum/{name}' are no worlds")
    marks.zero_()
    marks[worlds[worlds < len(marks)]] = True


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
        self._ended, self._total = number_in(state, "ended"), state["total"]
