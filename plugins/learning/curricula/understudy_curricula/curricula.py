"""Curricula of one number, the difficulty, and what follows from it: decision rate and time limit."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal

import torch
from torch import Tensor

from understudy import distributed
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_curricula.episodes import Judged, first_difficulty, mark_worlds, number_in


@dataclass(frozen=True)
class Knots:
    """A function of the difficulty, as (difficulty, value) with rising difficulties."""

    #: Control periods of a decision: the value of the last knot that is not above the difficulty.
    decision: tuple[tuple[float, int], ...] = ()
    #: Seconds after which episodes are cut, linear between knots. Evaluations have their own.
    episode_limit: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        for name, least in (("decision", 1), ("episode_limit", 0)):
            knots = getattr(self, name)
            if any(a[0] >= b[0] for a, b in pairwise(knots)):
                raise ValueError(f"{name}={knots} is not possible: difficulties must rise.")
            if any(value < least or value <= 0 for _, value in knots):
                raise ValueError(f"{name}={knots} is not possible: values must be positive.")

    def decision_at(self, difficulty: float) -> int | None:
        reached = [periods for at, periods in self.decision if at <= difficulty + 1e-9]
        return reached[-1] if reached else None

    def limit_at(self, difficulty: float) -> float:
        """Seconds."""
        knots = self.episode_limit
        for (low, before), (high, after) in pairwise(knots):
            if difficulty < high:
                share = max(0.0, (difficulty - low) / (high - low))
                return before + (after - before) * share
        return knots[-1][1]


class _OfDifficulty(Curriculum):
    """The present difficulty, on the device too, changed in place; and what follows from it."""

    def __init__(self, difficulty: float, knots: Knots, context: Context) -> None:
        self.knots = knots
        self._on_device = {"difficulty": torch.zeros(context.num_worlds, device=context.device)}
        if knots.episode_limit:
            self._on_device["episode_limit"] = torch.zeros_like(self._on_device["difficulty"])
        self.provides: Mapping[str, Shape] = {name: () for name in self._on_device}
        self.move(difficulty)

    def move(self, difficulty: float) -> None:
        self.difficulty = difficulty
        self._on_device["difficulty"].fill_(difficulty)
        if self.knots.episode_limit:
            self._on_device["episode_limit"].fill_(self.knots.limit_at(difficulty))

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return dict(self._on_device)

    def decision(self) -> int | None:
        return self.knots.decision_at(self.difficulty)

    def stage(self) -> str:
        return f"difficulty {self.difficulty:.2f}"


class Linear(_OfDifficulty):
    """The difficulty rises evenly to the task's over the first ``samples`` of a training."""

    @dataclass(frozen=True)
    class Options:
        samples: int  #: training samples until the task's difficulty, from 1
        start: float = 0.0  #: the first difficulty, in [0, 1]
        knots: Knots = Knots()  #: what changes with the difficulty

        def __post_init__(self) -> None:
            check_range(self, "samples", least=1, most=2**53)
            check_range(self, "start", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._target = options, context.difficulty
        self._samples = 0
        first = context.difficulty if context.evaluating else options.start
        super().__init__(first, options.knots, context)

    def update(self, rollout: Rollout) -> dict[str, float]:
        options, before = self._options, self.decision()
        done = self._samples >= options.samples
        self._samples += rollout.rewards.numel() * distributed.size()
        share = min(1.0, self._samples / options.samples)
        self.move(options.start + (self._target - options.start) * share)
        found = {"difficulty": self.difficulty}
        if (share == 1.0 and not done) or before != self.decision():
            found[f"mark/{self.stage()}"] = 1.0
        return found

    def state_dict(self) -> State:
        return {"samples": self._samples, "difficulty": self.difficulty}

    def load_state_dict(self, state: State) -> None:
        self._samples = number_in(state, "samples")
        self.move(number_in(state, "difficulty", most=1.0))


class Adaptive(_OfDifficulty):
    """The difficulty rises by a step, up to the task's, whenever recent episodes went well enough.

    Episodes are judged together, ``episodes`` or more at a time, by their mean return or the share that
    succeeded. After a step, only episodes that begin later count.
    """

    @dataclass(frozen=True)
    class Options:
        threshold: float  #: mean return, or share of successes, from which on the difficulty rises
        #: what is judged: the share of successes, or the mean return
        by: Literal["return", "success"] = "success"
        start: float = 0.0  #: the first difficulty, in [0, 1]
        step: float = 0.1  #: by how much the difficulty rises, above 0, at most 1
        episodes: int = 64  #: how many ended episodes are judged together at least
        counts: str | None = None  #: field (N,): only episodes where it is not 0 count; null, all
        knots: Knots = Knots()  #: what changes with the difficulty

        def __post_init__(self) -> None:
            check_range(self, "start", least=0, most=1)
            check_range(self, "step", above=0, most=1)
            check_range(self, "episodes", least=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._target = options, context.difficulty
        self.rollout_fields = (options.counts,) if options.counts else ()
        self._judged = Judged(options.episodes, options.by, options.threshold)
        super().__init__(first_difficulty(options.start, context), options.knots, context)
        # Worlds whose present episode began before the last step.
        self._older = torch.zeros(context.num_worlds, dtype=torch.bool, device=context.device)

    def update(self, rollout: Rollout) -> dict[str, float]:
        options = self._options
        ended = rollout.ended
        first = ended & (ended.cumsum(0) == 1)
        counted = ended & ~(first & self._older)
        if options.counts:
            counted &= rollout.fields[options.counts] != 0
        self._older &= ~ended.any(0)
        succeeded = (rollout.terminated & ~rollout.failed).float()
        score = succeeded if options.by == "success" else rollout.episode_returns
        metrics, passed = self._judged.digest(counted, score)
        found = {"difficulty": self.difficulty, **metrics}
        if passed and self.difficulty < self._target:
            self.move(min(self._target, self.difficulty + options.step))
            self._older.fill_(True)
            found |= {"difficulty": self.difficulty, f"mark/{self.stage()}": 1.0}
        return found

    def state_dict(self) -> State:
        return {
            "difficulty": self.difficulty, **self._judged.state_dict(),
            "older": self._older.nonzero().flatten().tolist(),
        }  # fmt: skip

    def load_state_dict(self, state: State) -> None:
        self._judged.load_state_dict(state)
        self.move(number_in(state, "difficulty", most=1.0))
        mark_worlds(self._older, state, "older")
