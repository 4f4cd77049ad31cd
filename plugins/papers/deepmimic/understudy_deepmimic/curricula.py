"""Time-based curricula: training episodes get longer, until T(z) (thesis, section 6.4.2).

Evaluations last T(z) always.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from understudy import distributed
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_curricula.episodes import number_in, totals
from understudy_deepmimic.horizon import horizon


class Episodes(NamedTuple):
    """Of several episodes, over all processes."""

    ended: float  #: how many
    failed: float  #: how many of them
    returns: float  #: their sum

    @classmethod
    def ended_in(cls, rollout: Rollout) -> Episodes:
        ended = rollout.ended
        returns = torch.where(ended, rollout.episode_returns, 0.0)
        return cls(*totals(ended, rollout.failed & ended, returns))

    @property
    def fail_rate(self) -> float:
        return self.failed / self.ended if self.ended else 1.0

    @property
    def mean_return(self) -> float:
        return self.returns / self.ended if self.ended else 0.0


class Recent:
    """The last episodes, at least as many as there are worlds.

    One iteration may be shorter than an episode. Worlds that began together then fail in some
    iterations and reach their limit in another, and neither alone tells how they fare.
    """

    def __init__(self, num_worlds: int) -> None:
        self._least = num_worlds * distributed.size()
        self._iterations: list[Episodes] = []

    def digest(self, episodes: Episodes) -> Episodes:
        """With one iteration's `episodes`, the last ones together."""
        iterations = self._iterations
        iterations.append(episodes)
        while sum(found.ended for found in iterations[1:]) >= self._least:
            iterations.pop(0)
        return Episodes(*(sum(values) for values in zip(*iterations, strict=True)))

    def state_dict(self) -> list[list[float]]:
        return [list(episodes) for episodes in self._iterations]

    def load_state_dict(self, state: Sequence[Sequence[float]]) -> None:
        iterations = [Episodes(*values) for values in state]
        for episodes in iterations:
            number_in(episodes._asdict(), "ended")
            number_in(episodes._asdict(), "failed", most=episodes.ended)
        self._iterations = iterations


class Stagnation:
    """Whether the return has not increased in the last `patience` iterations in which episodes ended."""

    def __init__(self, patience: int | None) -> None:
        self._patience, self._best, self._since = patience, 0.0, 0

    def digest(self, mean_return: float) -> None:
        self._since = 0 if mean_return > self._best else self._since + 1
        self._best = max(self._best, mean_return)

    @property
    def reached(self) -> bool:
        return self._patience is not None and self._since >= self._patience

    def state_dict(self) -> dict[str, float]:
        return {"best": self._best, "since": self._since}

    def load_state_dict(self, state: State) -> None:
        self._best, self._since = state["best"], number_in(state, "since")


class _OfLength(Curriculum):
    """How long episodes last that begin now, s, on the device too, changed in place; and how the last ones
    went."""

    provides: Mapping[str, Shape] = {"episode_limit": ()}

    def __init__(self, seconds: float, patience: int | None, context: Context) -> None:
        self._recent, self._stagnation = Recent(context.num_worlds), Stagnation(patience)
        self.longest = horizon(context.difficulty)
        self._decisions = self.longest / (context.control_dt * context.decision)
        self._on_device = torch.zeros(context.num_worlds, device=context.device)
        if seconds > self.longest and not context.evaluating:
            raise ConfigError(
                f"curriculum.start={seconds:g} is not possible: episodes last {self.longest:g} s at most with "
                f"difficulty={context.difficulty:g}. Give less."
            )
        self.move(seconds)

    def move(self, seconds: float) -> None:
        self.seconds = min(seconds, self.longest)
        self._on_device.fill_(self.seconds)

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return {"episode_limit": self._on_device}

    def digest(self, rollout: Rollout) -> dict[str, float]:
        """Metrics of the last episodes."""
        episodes = Episodes.ended_in(rollout)
        recent = self._recent.digest(episodes)
        if episodes.ended:
            self._stagnation.digest(recent.mean_return)
        return {
            "normalised_return": recent.mean_return / self._decisions,
            "fail_rate": recent.fail_rate,
            "episode_limit": self.seconds,
        }

    def finished(self) -> bool:
        return self._stagnation.reached

    def stage(self) -> str:
        return f"episodes of {self.seconds:.1f} s"

    def state_dict(self) -> State:
        """Without how long they last, which each curriculum knows."""
        return {
            "recent": self._recent.state_dict(),
            "stagnation": self._stagnation.state_dict(),
        }

    def load_state_dict(self, state: State) -> None:
        self._recent.load_state_dict(state["recent"])
        self._stagnation.load_state_dict(state["stagnation"])


class Adaptive(_OfLength):
    """Episodes last a second at first, and half a second more after every iteration as long as less than
    a fifth of them fail.

    The training ends when the return has not increased for ``patience`` iterations.
    """

    @dataclass(frozen=True)
    class Options:
        start: float = 1.0  #: s, above 0, that episodes last at first
        step: float = 0.5  #: s, above 0, by which they get longer at a time
        fail_rate: float = 0.2  #: share of failed episodes below which episodes get longer
        patience: int | None = 500  #: iterations; null goes on to the budget

        def __post_init__(self) -> None:
            check_range(self, "start", "step", above=0)
            check_range(self, "fail_rate", above=0, most=1)
            check_range(self, "patience", least=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        super().__init__(options.start, options.patience, context)

    def update(self, rollout: Rollout) -> dict[str, float]:
        found = self.digest(rollout)
        if found["fail_rate"] < self._options.fail_rate and self.seconds < self.longest:
            self.move(self.seconds + self._options.step)
            if self.seconds == self.longest:
                found[f"mark/{self.stage()}"] = 1.0
        return found

    def state_dict(self) -> State:
        return {"seconds": self.seconds, **super().state_dict()}

    def load_state_dict(self, state: State) -> None:
        self.move(number_in(state, "seconds", most=self.longest))
        super().load_state_dict(state)


class Annealed(_OfLength):
    """The fixed schedule of the released DeepMimic: from half a second, by the fourth power of the share
    of ``samples`` that are consumed.

    The training ends when the return has not increased for ``patience`` iterations.
    """

    @dataclass(frozen=True)
    class Options:
        start: float = 0.5  #: s, above 0, that episodes last at first (the released program)
        #: training samples until episodes are longest, from 1 (the released program)
        samples: int = 32_000_000
        power: float = 4.0  #: exponent of the share of ``samples``, above 0 (the released program)
        patience: int | None = 500  #: iterations; null goes on to the budget

        def __post_init__(self) -> None:
            check_range(self, "start", "power", above=0)
            check_range(self, "samples", least=1, most=2**53)
            check_range(self, "patience", least=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        super().__init__(options.start, options.patience, context)
        self._samples = 0

    def _move_along(self) -> None:
        options = self._options
        share = min(1.0, self._samples / options.samples) ** options.power
        self.move(options.start + (self.longest - options.start) * share)

    def update(self, rollout: Rollout) -> dict[str, float]:
        found = self.digest(rollout)
        self._samples += rollout.rewards.numel() * distributed.size()
        self._move_along()
        return found

    def state_dict(self) -> State:
        return {"samples": self._samples, **super().state_dict()}

    def load_state_dict(self, state: State) -> None:
        self._samples = number_in(state, "samples")
        self._move_along()
        super().load_state_dict(state)
