"""Segments of a motion: the average returns of their states, and how often episodes begin in each (eq. 3.9)."""

from __future__ import annotations

from typing import Literal

import torch
from torch import Tensor

from understudy import distributed
from understudy.random import WorldStreams
from understudy.task import Rollout, State

#: Whose returns count for a segment: those of all states that pass through it, or only of those in which
#: episodes began ("the average estimated return starting from states in segment k").
By = Literal["visits", "starts"]


def segment_probabilities(returns: Tensor, *, uniform: float) -> Tensor:
    """p(k) of eq. 3.9 for the segments' average returns w, (n,): low returns are drawn more often.

    The scale v is (max w - min w) / 3; equal returns give the uniform distribution.
    """
    low = returns.min()
    spread = returns.max() - low
    scale = torch.where(
        spread > torch.finfo(spread.dtype).tiny, spread / 3, torch.ones_like(spread)
    )
    return (1 - uniform) * torch.softmax((low - returns) / scale, dim=0) + uniform / len(returns)


def of_segments(phase: Tensor, count: int) -> Tensor:
    """(count, B) bool: which states at `phase` (B,) in [0, 1) belong to which of `count` equal segments."""
    index = (phase * count).long().clamp(0, count - 1)
    return index == torch.arange(count, device=index.device).unsqueeze(1)


def counted(rollout: Rollout, of_segment: Tensor, by: By) -> Tensor:
    """`of_segment` (n, T N) without the states that do not count for eq. 3.9."""
    if by == "visits":
        return of_segment
    return of_segment & (rollout.fields["episode_step"].flatten() == 0)


class Segments:
    """By motion segment: the running average of the estimated returns of its states; and the distribution of
    eq. 3.9 over segments. Tensors stay the same objects, since captured steps read them."""

    def __init__(
        self, segments: int, *, uniform: float, decay: float, device: torch.device
    ) -> None:
        self.average = torch.zeros(segments, device=device)
        self.seen = torch.zeros(segments, device=device)
        self.cumulative = torch.arange(1, segments + 1, device=device) / segments
        self._uniform, self._decay = uniform, decay

    def of(self, phase: Tensor) -> Tensor:
        """(n, B) bool: which states at `phase` (B,) belong to which segment."""
        return of_segments(phase, len(self.average))

    def update(self, of_segment: Tensor, returns: Tensor) -> Tensor:
        """Learn from the states' `returns` (B,); the probabilities (n,)."""
        # Not index_add_, whose order of summation differs from run to run on a GPU.
        sums, counts = torch.where(of_segment, returns, 0.0).sum(1), of_segment.sum(1).float()
        sums, counts = distributed.total(torch.stack([sums, counts]))
        mean = sums / counts.clamp(min=1.0)
        keep = torch.where(self.seen > 0, self._decay, 0.0)
        updated = keep * self.average + (1 - keep) * mean
        self.average.copy_(torch.where(counts > 0, updated, self.average))
        self.seen += counts

        seen = self.seen > 0  # segments without samples count as average
        mean = (self.average * seen).sum() / seen.sum().clamp(min=1)
        returns = torch.where(seen, self.average, mean)
        probabilities = segment_probabilities(returns, uniform=self._uniform)
        self.cumulative.copy_(probabilities.cumsum(0) / probabilities.sum())
        return probabilities

    def draw(self, streams: WorldStreams) -> tuple[Tensor, Tensor]:
        """A segment by its probability and a uniform position within it, each (N,)."""
        draws = streams.uniform(2)
        segment = torch.searchsorted(self.cumulative, draws[:, :1].contiguous()).squeeze(1)
        return segment.clamp(max=len(self.cumulative) - 1), draws[:, 1]

    def state_dict(self) -> dict[str, Tensor]:
        return {name: getattr(self, name).clone() for name in ("average", "seen", "cumulative")}

    def load_state_dict(self, state: State) -> None:
        for name in ("average", "seen", "cumulative"):
            getattr(self, name).copy_(state[name])
