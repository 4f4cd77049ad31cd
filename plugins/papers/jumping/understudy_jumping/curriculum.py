"""The curriculum of section 4.6.1: the bar rises when enough reward has come together."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy import distributed
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_curricula.episodes import first_difficulty
from understudy_tensors.groups import Groups


class Accumulated(Curriculum):
    """Each iteration's mean return of the episodes that ended is added up; beyond R_T (table 4.1) the
    difficulty rises by a step and the sum begins anew.

    The paper's iteration has 4096 samples; a larger one counts as several. With `groups`, world i
    belongs to group i mod groups, and each group has a difficulty of its own; how long decisions last
    follows from the mean of these.
    """

    @dataclass(frozen=True)
    class Options:
        #: R_T, sum of mean returns beyond which a step is taken (table 4.1)
        threshold: float = 30.0
        step: float = 1 / 150  #: by how much the difficulty rises at a time: Δz over z_max - z_min
        start: float = 0.0  #: the first difficulty, in [0, 1]
        batch: int = 4096  #: samples in an iteration of the paper
        groups: int = 1  #: how many groups worlds form, from 1, each with a difficulty of its own
        #: Control periods of a decision: (difficulty, periods) with rising difficulties.
        decision: tuple[tuple[float, int], ...] = field(default_factory=tuple)

        def __post_init__(self) -> None:
            check_range(self, "threshold", above=0)
            check_range(self, "step", above=0, most=1)
            check_range(self, "start", least=0, most=1)
            check_range(self, "batch", "groups", least=1, most=100_000)
            difficulties = [at for at, _ in self.decision]
            if difficulties != sorted(difficulties) or any(n < 1 for _, n in self.decision):
                raise ValueError(
                    f"decision={[list(pair) for pair in self.decision]} is not possible: give pairs of a "
                    "difficulty, rising, and of 1 control period or more."
                )

    def __init__(self, options: Options, context: Context) -> None:
        if options.groups > context.num_worlds and not context.evaluating:
            raise ConfigError(
                f"curriculum.groups={options.groups} is more than there are worlds ({context.num_worlds}). "
                "Give as many as there are take-offs (initial_states.others, and one)."
            )
        self._options, self._target = options, context.difficulty
        first = first_difficulty(options.start, context)
        self._difficulty = [first] * options.groups
        self._sums = [0.0] * options.groups
        self._groups = Groups([str(row) for row in range(options.groups)], context)
        self._on_device = torch.full((context.num_worlds,), first, device=context.device)
        self.provides: Mapping[str, Shape] = {"difficulty": ()}

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"difficulty": self._on_device}

    def decision(self) -> int | None:
        mean = sum(self._difficulty) / len(self._difficulty)
        reached = [n for at, n in self._options.decision if at <= mean + 1e-9]
        return reached[-1] if reached else None

    def _set(self) -> None:
        values = torch.tensor(self._difficulty, device=self._on_device.device)
        self._on_device.copy_(self._groups.of_worlds(values))

    def update(self, rollout: Rollout) -> dict[str, float]:
        options, before = self._options, self.decision()
        ended = rollout.ended.double()
        returns = (ended * rollout.episode_returns).sum(dim=0)
        sums = self._groups.sums(torch.stack([ended.sum(dim=0), returns]))
        counts, totals = distributed.total(sums).tolist()
        share = rollout.rewards.numel() * distributed.size() / options.batch
        rose = False
        for group, (count, total) in enumerate(zip(counts, totals, strict=True)):
            self._sums[group] += share * total / count if count else 0.0
            if self._sums[group] > options.threshold and self._difficulty[group] < self._target:
                self._sums[group], rose = 0.0, True
                raised = self._difficulty[group] + options.step
                self._difficulty[group] = min(self._target, raised)
        if rose:
            self._set()
        found = {"difficulty": sum(self._difficulty) / options.groups}
        if options.groups > 1:
            found |= {f"difficulty_{i}": value for i, value in enumerate(self._difficulty)}
        if before != self.decision():
            found[f"mark/{self.stage()}"] = 1.0
        return found

    def stage(self) -> str:
        if len(self._difficulty) == 1:
            return f"difficulty {self._difficulty[0]:.2f}"
        return f"difficulties {min(self._difficulty):.2f} to {max(self._difficulty):.2f}"

    def state_dict(self) -> State:
        return {"difficulty": list(self._difficulty), "sums": list(self._sums)}

    def load_state_dict(self, state: State) -> None:
        for name in ("difficulty", "sums"):
            if len(state[name]) != self._options.groups:
                raise ValueError(
                    f"'curriculum/{name}' is of {self._options.groups} groups here and "
                    f"{len(state[name])} there"
                )
        if not all(float(difficulty) >= 0 for difficulty in state["difficulty"]):
            raise ValueError(f"'curriculum/difficulty' cannot be {state['difficulty']}")
        self._difficulty = [min(self._target, float(d)) for d in state["difficulty"]]
        self._sums = [float(total) for total in state["sums"]]
        self._set()
