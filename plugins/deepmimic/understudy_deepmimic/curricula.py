"""Time-based curricula: training episodes get longer, until T(z) (thesis, section 6.4.2).

Evaluations last T(z) always.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import NamedTuple

import torch
from torch import Tensor

from understudy import distributed
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, Curriculum, Rollout, Shape, State
from understudy_deepmimic.horizon import horizon


class Episodes(NamedTuple):
    """Of the episodes that ended in an iteration, over all processes."""

    ended: float
    failed: float  #: how many
    returns: float  #: their sum


def ended_in(rollout: Rollout) -> Episodes:
    ended = rollout.terminated | rollout.truncated
    returns = torch.where(ended, rollout.episode_returns, 0.0)
    sums = [value.double().sum() for value in (ended, rollout.failed & ended, returns)]
    return Episodes(*distributed.total(torch.stack(sums)).tolist())


class Stagnation:
    """Whether the return has not increased for `patience` iterations.

    It is that of the episodes that ended, averaged over about `smoothing` iterations since few do in
    one.
    """

    _KEPT = ("average", "weight", "best", "since")

    def __init__(self, patience: int | None, smoothing: float = 20.0) -> None:
        self._patience, self._keep = patience, 1.0 - 1.0 / smoothing
        self._average, self._weight, self._best, self._since = 0.0, 0.0, 0.0, 0

    def digest(self, episodes: Episodes) -> float:
        """One iteration's `episodes`; returns the average return."""
        if episodes.ended:
            mean = episodes.returns / episodes.ended
            self._average = self._keep * self._average + (1 - self._keep) * mean
            self._weight = self._keep * self._weight + (1 - self._keep)
        average = self._average / max(self._weight, 1e-9)
        self._since = 0 if average > self._best else self._since + 1
        self._best = max(self._best, average)
        return average

    @property
    def reached(self) -> bool:
        return self._patience is not None and self._since >= self._patience

    def state_dict(self) -> dict[str, float]:
        return {name: getattr(self, f"_{name}") for name in self._KEPT}

    def load_state_dict(self, state: State) -> None:
        for name in self._KEPT:
            setattr(self, f"_{name}", state[name])


class _Limit:
    """How long episodes last that begin now, s, on the device too, changed in place."""

    provides: Mapping[str, Shape] = {"episode_limit": ()}

    def __init__(self, seconds: float, context: Context) -> None:
        self.longest = horizon(context.difficulty)
        self._decisions = self.longest / (context.control_dt * context.decision)
        self._on_device = torch.zeros(context.num_worlds, device=context.device)
        self.move(seconds)

    def move(self, seconds: float) -> None:
        self.seconds = min(seconds, self.longest)
        self._on_device.fill_(self.seconds)

    def begin(self) -> dict[str, Tensor]:
        return {"episode_limit": self._on_device}

    def metrics(self, average: float) -> dict[str, float]:
        """Of an iteration with the `average` return."""
        return {
            "normalised_return": average / self._decisions,
            "episode_limit": self.seconds,
        }

    def __str__(self) -> str:
        return f"episodes of {self.seconds:.1f} s"


class FailRate:
    """The share of the last episodes that failed, at least as many as there are worlds.

    One iteration may be shorter than an episode. Worlds that began together then fail in some
    iterations and reach their limit in another, and neither alone tells how many fail.
    """

    def __init__(self, num_worlds: int) -> None:
        self._least = num_worlds * distributed.size()
        self._recent: list[tuple[float, float]] = []  #: ended and failed, by iteration

    def digest(self, episodes: Episodes) -> float:
        """One iteration's `episodes`; returns the share."""
        recent = self._recent
        recent.append((episodes.ended, episodes.failed))
        while sum(ended for ended, _ in recent[1:]) >= self._least:
            recent.pop(0)
        ended, failed = (sum(counts) for counts in zip(*recent, strict=True))
        return failed / ended if ended else 1.0

    def state_dict(self) -> dict[str, list[list[float]]]:
        return {"recent": [list(counts) for counts in self._recent]}

    def load_state_dict(self, state: State) -> None:
        self._recent = [(ended, failed) for ended, failed in state["recent"]]


class Adaptive(Curriculum):
    """Episodes last a second at first, and half a second more after every iteration as long as less than
    a fifth of them fail.

    The training ends when the return has not increased for ``patience`` iterations.
    """

    provides = _Limit.provides

    @dataclass(frozen=True)
    class Options:
        start: float = 1.0  #: s
        step: float = 0.5  #: s
        fail_rate: float = 0.2  #: below which episodes get longer
        patience: int | None = 500  #: iterations; null goes on to the budget

        def __post_init__(self) -> None:
            check_range(self, "start", "step", above=0)
            check_range(self, "fail_rate", above=0, most=1)
            check_range(self, "patience", least=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        self._limit = _Limit(options.start, context)
        self._fail_rate = FailRate(context.num_worlds)
        self._stagnation = Stagnation(options.patience)

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return self._limit.begin()

    def update(self, rollout: Rollout) -> dict[str, float]:
        episodes, limit = ended_in(rollout), self._limit
        fail_rate = self._fail_rate.digest(episodes)
        found = limit.metrics(self._stagnation.digest(episodes)) | {"fail_rate": fail_rate}
        if fail_rate < self._options.fail_rate and limit.seconds < limit.longest:
            limit.move(limit.seconds + self._options.step)
            if limit.seconds == limit.longest:
                found[f"mark/{limit}"] = 1.0
        return found

    def finished(self) -> bool:
        return self._stagnation.reached

    def stage(self) -> str:
        return str(self._limit)

    def state_dict(self) -> State:
        return {
            "seconds": self._limit.seconds,
            **self._fail_rate.state_dict(),
            **self._stagnation.state_dict(),
        }

    def load_state_dict(self, state: State) -> None:
        self._limit.move(state["seconds"])
        self._fail_rate.load_state_dict(state)
        self._stagnation.load_state_dict(state)


class Annealed(Curriculum):
    """The fixed schedule of the released DeepMimic: from half a second, by the fourth power of the share
    of ``samples`` that are consumed.

    The training ends when the return has not increased for ``patience`` iterations.
    """

    provides = _Limit.provides

    @dataclass(frozen=True)
    class Options:
        start: float = 0.5  #: s
        samples: int = 32_000_000
        power: float = 4.0
        patience: int | None = 500  #: iterations; null goes on to the budget

        def __post_init__(self) -> None:
            check_range(self, "start", "power", above=0)
            check_range(self, "samples", "patience", least=1)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options
        self._limit = _Limit(options.start, context)
        self._stagnation = Stagnation(options.patience)
        self._samples = 0

    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        return self._limit.begin()

    def _move(self) -> None:
        options, limit = self._options, self._limit
        share = min(1.0, self._samples / options.samples) ** options.power
        limit.move(options.start + (limit.longest - options.start) * share)

    def update(self, rollout: Rollout) -> dict[str, float]:
        found = self._limit.metrics(self._stagnation.digest(ended_in(rollout)))
        self._samples += rollout.rewards.numel() * distributed.size()
        self._move()
        return found

    def finished(self) -> bool:
        return self._stagnation.reached

    def stage(self) -> str:
        return str(self._limit)

    def state_dict(self) -> State:
        return {"samples": self._samples, **self._stagnation.state_dict()}

    def load_state_dict(self, state: State) -> None:
        self._samples = state["samples"]
        self._move()
        self._stagnation.load_state_dict(state)
