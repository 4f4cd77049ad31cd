"""What an evaluation found, in figures, JSON and words."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

from torch import Tensor

from understudy.running.jobs import Judgement

__all__ = ["Evaluation", "Measured", "wilson_interval"]


@dataclass(frozen=True)
class Measured:
    """One measure over the episodes of an evaluation; NaN if no episode has it."""

    reduce: str  #: how an episode's values became one
    mean: float
    spread: float  #: standard deviation over episodes
    low: float | None  #: of the 95 % interval of the mean; None where one value says nothing of it
    high: float | None

    @classmethod
    def of(cls, reduce: str, values: Tensor, starts: int | None = None) -> Measured:
        """From one value per episode, (E,). Values that are not finite are left out, such as those of episodes that went
        wrong in their first step. `starts`, the number of different states in which they began, is the n of the mean's
        interval by Student's t: mean ± t(0.975, n - 1) · s / √n."""
        values = values[values.isfinite()].double()
        if not len(values):
            return cls(reduce, math.nan, math.nan, None, None)
        mean = float(values.mean())
        spread = float(values.std()) if len(values) > 1 else 0.0
        n = min(len(values), starts or len(values))
        of_episodes = reduce in ("min", "max", "last") and bool(
            ((values == 0) | (values == 1)).all()
        )
        if reduce == "any" or of_episodes:  # a share: its interval stays between 0 and 1
            return cls(reduce, mean, spread, *wilson_interval(mean, n))
        if n < 2:
            return cls(reduce, mean, spread, None, None)
        from scipy.special import stdtrit  # takes its time

        reach = float(stdtrit(n - 1, 0.975)) * spread / math.sqrt(n)
        return cls(reduce, mean, spread, mean - reach, mean + reach)

    def as_json(self) -> dict[str, Any]:
        if math.isnan(self.mean):
            return {"reduce": self.reduce, "mean": None, "spread": None, "mean_95": None}
        found = {"reduce": self.reduce, "mean": self.mean, "spread": self.spread}
        return {**found, "mean_95": None if self.low is None else [self.low, self.high]}


@dataclass(frozen=True)
class Evaluation(Judgement):
    """What an evaluation found. Shares are of episodes."""

    violated: Mapping[str, float] = field(default_factory=dict)  #: by termination term
    cut: Mapping[str, float] = field(default_factory=dict)  #: by truncation that ended them
    measures: Mapping[str, Measured] = field(default_factory=dict)
    objective: str = "success_rate"  #: what searches maximise: this, or a measure
    seconds: float | None = None  #: the episodes' length
    unsound: float = 0.0  #: share whose numbers went wrong; they are no success
    #: in how many states episodes began; None if nobody counted
    different_starts: int | None = None
    #: Of each episode a digest of where it began, and what `compared` came to; empty if nobody counted.
    outcomes: Sequence[tuple[bytes, float]] = field(default=(), compare=False, repr=False)
    compared: str = "success"  #: what `outcomes` are of: success, 1 or 0, or a measure

    @property
    def trials(self) -> int:
        """The number of different starts, if they were counted: a deterministic policy repeats itself from the same
        start, unless something is drawn on the way. With fewer of them, intervals are wider, never too narrow."""
        return self.episodes if self.different_starts is None else self.different_starts

    @property
    def objective_value(self) -> float | None:
        if self.objective == "success_rate":
            return self.success_rate
        value = self.measures[self.objective].mean
        return None if math.isnan(value) else value

    def row(self, kind: str = "evaluation") -> dict[str, float]:
        """KIND/success_rate, or KIND/success_rate_at_most alone."""
        found = {f"{kind}/{name}": m.mean for name, m in self.measures.items() if self.complete}
        if self.success_rate is not None:
            name = "success_rate" if self.complete else "success_rate_at_most"
            found[f"{kind}/{name}"] = self.success_rate
        return found | ({f"{kind}/unsound": self.unsound} if self.unsound else {})

    def as_json(self, samples: int, changed: Sequence[str] = ()) -> dict[str, Any]:
        found: dict[str, Any] = {
            "episodes": self.episodes,
            "seconds": self.seconds,
            "samples": samples,
            "policy": "deterministic",
            "starts": "never used in training",
            "different_starts": self.different_starts,
            "mean_episode_seconds": self.mean_episode_seconds,
            "violated": dict(self.violated),
            "cut": dict(self.cut),
            "unsound": self.unsound,
            "measures": {name: m.as_json() for name, m in self.measures.items()},
            "objective": {"name": self.objective, "value": self.objective_value},
        }
        if self.success_rate is not None:
            low, high = wilson_interval(self.success_rate, self.trials)
            found |= {
                "success": self.success,
                "success_rate": self.success_rate,
                "success_rate_95": [low, high],
            }
        return found | ({"changed": list(changed)} if changed else {})

    def sentence(self) -> str:
        known = {n: m.mean for n, m in self.measures.items() if not math.isnan(m.mean)}
        figures = [
            f"{n} {mean:.3g}" for n, mean in known.items() if n != "return" and self.complete
        ]
        if self.unsound:
            figures.append(f"numbers went wrong in {shown_share(self.unsound)} of the episodes")
        if self.trials < self.episodes:
            one = self.trials == 1
            states, of = (
                ("the same state", "it") if one else (f"{self.trials} different states", "these")
            )
            figures.append(
                f"the {self.episodes} episodes began in {states}, so they tell of {of} alone"
            )
        if self.success_rate is None:
            return "; ".join(figures or ["nothing was measured"]) + "."
        most, early = ("", "") if self.complete else ("at most ", ", stopped early")
        text = f"{most}{self.success_rate:.0%} of {self.episodes} episodes succeeded{early} ({self.success})"
        if cut := [f"{name} cut {share:.0%} short" for name, share in self.cut.items() if share]:
            cut.append(f"on average they lasted {self.mean_episode_seconds:.3g} s")
        return "; ".join([text, *cut, *figures]) + "."


def shown_share(share: float) -> str:
    """In per cent; never 0 % of something, nor 100 % if something is missing."""
    text = f"{share:.0%}"
    return {"0%": "under 1%", "100%": "over 99%"}.get(text, text) if 0 < share < 1 else text


def wilson_interval(rate: float, n: int, z: float = 1.96) -> tuple[float, float]:
    """The Wilson score interval of a share `rate` of `n` (95 % by default)."""
    if n == 0:
        return 0.0, 1.0
    centre = rate + z * z / (2 * n)
    spread = z * math.sqrt(rate * (1 - rate) / n + z * z / (4 * n * n))
    scale = 1 + z * z / n
    return max(0.0, (centre - spread) / scale), min(1.0, (centre + spread) / scale)
