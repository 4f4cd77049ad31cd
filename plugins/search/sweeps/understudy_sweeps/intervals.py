"""Means over seeds, with 95 % intervals that hold for few seeds."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtr, stdtrit

__all__ = [
    "FAILS",
    "UNDECIDED",
    "from_below",
    "mean_of",
    "paired_difference",
    "verdict",
    "verdict_between",
]


@dataclass(frozen=True)
class Mean:
    """The mean of `count` values, and the 95 % interval of the mean that they are drawn from."""

    value: float
    count: int
    #: None of one or two values, which say next to nothing of their spread
    low: float | None = None
    high: float | None = None

    def clipped(self, low: float, high: float) -> Mean:
        """The same for values that cannot be beyond these limits."""
        if self.low is None or self.high is None:
            return self
        return Mean(self.value, self.count, max(self.low, low), min(self.high, high))


def mean_of(values: Sequence[float]) -> Mean | None:
    """Student's t interval: mean ± t(0.975, n - 1) · s / √n; None without values.

    Two values get no interval: at 12.7 times their standard error, it would say nothing.
    """
    n = len(values)
    if n == 0:
        return None
    mean = statistics.fmean(values)
    if n <= 2:
        return Mean(mean, n)
    reach = t_quantile(n) * statistics.stdev(values) / math.sqrt(n)
    return Mean(mean, n, mean - reach, mean + reach)


HOLDS, FAILS, UNDECIDED, ONE = "holds", "does not hold", "undecided", "one seed"
"""Verdicts on a claim, by a two-sided Student's t over seeds at p < 0.05."""


def verdict(values: Sequence[float], than: float, better: Literal["less", "more"]) -> str:
    """Whether the mean that the `values` are drawn from is less or more `than` a number; "" without values."""
    if len(values) < 2:
        return ONE if values else ""
    more = statistics.fmean(values) - than
    error = statistics.stdev(values) / math.sqrt(len(values))
    return _told(more if better == "more" else -more, error, len(values) - 1)


def verdict_between(
    ours: Mapping[int, float], theirs: Mapping[int, float], better: Literal["less", "more"]
) -> str:
    """Whether `ours` are less or more than `theirs`, each by seed; "" if one of them is empty. Compared seed by seed if both
    have two or more seeds in common, else as two samples (Welch's t)."""
    fewest = min(len(ours), len(theirs))
    if fewest < 2:
        return ONE if fewest else ""
    both = [ours[seed] - theirs[seed] for seed in ours if seed in theirs]
    if len(both) > 1:
        return verdict(both, 0.0, better)
    first, second = list(ours.values()), list(theirs.values())
    more = statistics.fmean(first) - statistics.fmean(second)
    parts = [statistics.variance(v) / len(v) for v in (first, second)]
    down = sum(part**2 / (len(v) - 1) for part, v in zip(parts, (first, second), strict=True))
    degrees = sum(parts) ** 2 / down if down > 0 else 1.0
    return _told(more if better == "more" else -more, math.sqrt(sum(parts)), degrees)


def from_below(
    found: str, better: Literal["less", "more"], ours: bool, theirs: bool = False
) -> str:
    """The verdict `found`, where of `ours` or `theirs` some are known from below alone and counted as that: undecided if
    the side that has less may have more, which would speak against it. More on the other side says the same."""
    if found not in (HOLDS, FAILS):
        return found
    ours_is_less = (found == HOLDS) == (better == "less")
    return UNDECIDED if (ours if ours_is_less else theirs) else found


def _told(ahead: float, error: float, degrees: float) -> str:
    p = 2 * float(stdtr(degrees, -abs(ahead) / error)) if error > 0 else float(ahead == 0)
    return UNDECIDED if p >= 0.05 else HOLDS if ahead > 0 else FAILS


def t_quantile(count: int) -> float:
    """The 97.5 % quantile of Student's t with `count` - 1 degrees of freedom."""
    return float(stdtrit(count - 1, 0.975))


def paired_difference(first: Mapping[int, float], second: Mapping[int, float]) -> Mean | None:
    """The mean of `second` minus `first`, each by seed, over the seeds that both have, so that differences between seeds
    cancel."""
    return mean_of([second[seed] - first[seed] for seed in first if seed in second])
