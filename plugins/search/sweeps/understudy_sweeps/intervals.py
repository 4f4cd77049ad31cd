"""Means over seeds, with 95 % intervals that hold for few of them."""

from __future__ import annotations

import math
import statistics
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

from scipy.special import stdtr, stdtrit

__all__ = ["UNDECIDED", "mean_of", "paired_difference", "verdict"]


@dataclass(frozen=True)
class Mean:
    """The mean of `count` values, and the 95 % interval of what they are drawn around."""

    value: float
    count: int
    low: float | None = (
        None  #: None of one or two values, which say next to nothing of their spread
    )
    high: float | None = None

    def clipped(self, low: float, high: float) -> Mean:
        """For values that cannot lie beyond."""
        if self.low is None or self.high is None:
            return self
        return Mean(self.value, self.count, max(self.low, low), min(self.high, high))


def mean_of(values: Sequence[float]) -> Mean | None:
    """Student's t interval: mean ± t(0.975, n - 1) · s / √n; None without values.

    Two values have none: at 12.7 times their standard error it would hold, and say nothing.
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
    """Whether what the `values` are drawn around is less, or more, `than` a number; "" of none."""
    if len(values) < 2:
        return ONE if values else ""
    ahead = statistics.fmean(values) - than if better == "more" else than - statistics.fmean(values)
    spread = statistics.stdev(values) / math.sqrt(len(values))
    p = 2 * float(stdtr(len(values) - 1, -abs(ahead) / spread)) if spread > 0 else float(ahead == 0)
    return UNDECIDED if p >= 0.05 else HOLDS if ahead > 0 else FAILS


def t_quantile(count: int) -> float:
    """The 97.5 % quantile of Student's t with `count` - 1 degrees of freedom."""
    return float(stdtrit(count - 1, 0.975))


def paired_difference(first: Mapping[int, float], second: Mapping[int, float]) -> Mean | None:
    """How much more `second` has than `first`, each by seed, over the seeds that both have: what
    differs between seeds and not between variants falls out."""
    return mean_of([second[seed] - first[seed] for seed in first if seed in second])
