"""Worlds whose episodes are not in step."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_curricula.episodes import mark_worlds


class Staggered(Curriculum):
    """Each world's first episode is cut at a time drawn evenly between nothing and the whole episode, so that from
    then on the worlds are in all phases of an episode at once. Where all episodes last equally long and a rollout is only a part of one, worlds
    in step would give each update a single phase (Rudin et al. 2022, *Learning to walk in minutes*, section 3.1).

    *Limits:* a world whose episode is cut within a rollout is cut again until the rollout ends.
    """

    @dataclass(frozen=True)
    class Options:
        seconds: float  #: s, of all later episodes, as ``episode.seconds``

        def __post_init__(self) -> None:
            check_range(self, "seconds", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._seconds = options.seconds
        n, device = context.num_worlds, context.device
        drawn = WorldStreams(context.seed, "curriculum/staggered", n, device).uniform(1)
        self._cut = options.seconds * drawn[:, 0]
        #: Worlds whose first episode has not ended.
        self._first = torch.ones(n, dtype=torch.bool, device=device)
        self._limit = self._cut.clone()
        self.provides: Mapping[str, Shape] = {"episode_limit": ()}

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"episode_limit": self._limit}

    def update(self, rollout: Rollout) -> dict[str, float]:
        self._first &= ~rollout.ended.any(0)
        self._set()
        return {}

    def _set(self) -> None:
        self._limit.copy_(torch.where(self._first, self._cut, self._seconds))

    def stage(self) -> str:
        return "worlds out of step"

    def state_dict(self) -> State:
        return {"first": self._first.nonzero().flatten().tolist()}

    def load_state_dict(self, state: State) -> None:
        mark_worlds(self._first, state, "first")
        self._set()
