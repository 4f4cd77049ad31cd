"""The curriculum that takes the help away, lesson by lesson."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy import distributed
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_curricula.episodes import number_in, totals


class Lessons(Curriculum):
    """Help lessens by the factor `ratio` whenever the walker does well enough with what it has.

    Yu, Turk and Liu 2018, section 4.2.2, and their program: the first lesson is learned when episodes
    last `lasting` seconds on average at more than half the target speed. The mean return of that moment
    is the standard, and every later lesson is learned when episodes last as long and the mean return is
    at least `share` of it. Help of less than the share `least` of the full one is none.

    With full help at difficulty 0, the help of difficulty z is the share 1 - z, and the training leads
    to that of the task's own difficulty. Episodes are judged together, `episodes` of them or one of
    each world, whichever is more: short ones end first, and few would be no fair sample.

    The training ends when the mean return of a lesson has not increased for ``patience`` iterations:
    the last lesson's, or that of a lesson which is not learned.
    """

    rollout_fields = ("episode_time", "forward_velocity", "target_velocity")

    @dataclass(frozen=True)
    class Options:
        #: factor of the help from lesson to lesson, in (0, 1) (Yu et al. 2018, section 4.2.2)
        ratio: float = 0.75
        #: share of the first lesson's return at which a lesson is learned, in [0, 1] (Yu et al.
        #: 2018, section 4.2.2)
        share: float = 0.7
        #: share of the full help below which there is none, in [0, 1]; 5 of 200 N/m
        least: float = 0.025
        lasting: float = 6.0  #: s, from 0, that episodes must last on average
        speed: float = 0.5  #: share of the target velocity that must be reached, in [0, 1]
        episodes: int = 32  #: how many ended episodes are judged together at least
        #: iterations without a better return after which the training stops; null goes on to the
        #: budget
        patience: int | None = None

        def __post_init__(self) -> None:
            check_range(self, "ratio", above=0, most=0.99)
            check_range(self, "share", "least", "speed", least=0, most=1)
            check_range(self, "lasting", least=0)
            check_range(self, "episodes", "patience", least=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options, self._target = options, context.difficulty
        self._dt = context.control_dt * context.decision
        self._judged = max(options.episodes, context.num_worlds * distributed.size())
        self._difficulty = torch.zeros(context.num_worlds, device=context.device)
        self.provides: Mapping[str, Shape] = {"difficulty": ()}
        self._standard: float | None = None
        #: Of the lesson: ended episodes, their returns, their seconds; metres gone, and to go.
        self._sums = torch.zeros(5, dtype=torch.float64)
        self._move(context.difficulty if context.evaluating else 0.0)

    def _move(self, difficulty: float) -> None:
        self._at = difficulty
        #: The lesson's best mean return, and how many iterations ago that was.
        self._best: float | None = None
        self._since = 0
        self._difficulty.fill_(difficulty)

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"difficulty": self._difficulty}

    def next(self, difficulty: float) -> float:
        """The difficulty of the lesson after that of `difficulty`."""
        left = (1.0 - difficulty) * self._options.ratio
        return min(self._target, 1.0 if left < self._options.least else 1.0 - left)

    def update(self, rollout: Rollout) -> dict[str, float]:
        options, ended = self._options, rollout.ended
        seconds = rollout.fields["episode_time"] + self._dt
        sums = totals(
            ended,
            torch.where(ended, rollout.episode_returns, 0.0),
            torch.where(ended, seconds, 0.0),
            rollout.fields["forward_velocity"],
            rollout.fields["target_velocity"],
        )
        self._sums += torch.tensor(sums, dtype=torch.float64)
        self._since += 1
        found = {"difficulty": self._at}
        count, returns, lasted, gone, to_go = self._sums.tolist()
        if count < self._judged:
            return found
        self._sums.zero_()
        mean = found["return"] = returns / count
        found["seconds"] = lasted / count
        if self._best is None or mean > self._best:
            self._best, self._since = mean, 0
        learned = lasted / count >= options.lasting and gone >= options.speed * to_go
        if learned and self._standard is None:
            self._standard = mean
        if self._standard is None:
            return found
        found["standard"] = self._standard
        # a share of a negative return would be more than it
        enough = mean >= self._standard - (1.0 - options.share) * abs(self._standard)
        if learned and enough and self._at < self._target:
            self._move(self.next(self._at))
            found |= {"difficulty": self._at, f"mark/{self.stage()}": 1.0}
        return found

    def finished(self) -> bool:
        return self._options.patience is not None and self._since >= self._options.patience

    def stage(self) -> str:
        return f"help {1.0 - self._at:.0%}"

    def state_dict(self) -> State:
        return {
            "difficulty": self._at,
            "standard": self._standard,
            "best": self._best,
            "since": self._since,
            "sums": self._sums.clone(),
        }

    def load_state_dict(self, state: State) -> None:
        self._standard = state["standard"]
        self._sums.copy_(state["sums"])
        self._move(number_in(state, "difficulty", most=1.0))
        self._best, self._since = state["best"], number_in(state, "since")
