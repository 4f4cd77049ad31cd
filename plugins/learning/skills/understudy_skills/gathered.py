"""How far a job that gathers states has come, in the words and figures of a job."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from understudy.running.evaluation import Evaluation, Measured


def count_of(states: Mapping[str, Tensor]) -> int:
    """Of states, each field of them (S, …)."""
    return len(next(iter(states.values()))) if states else 0


def stage_of(count: int, wanted: int) -> str:
    return f"{min(count, wanted)} of {wanted} states"


def evaluation_of(count: int, wanted: int) -> Evaluation:
    """How many states there are; they need no other judgement."""
    states = torch.tensor([float(min(count, wanted))])
    return Evaluation(episodes=1, measures={"states": Measured.of("last", states)})
