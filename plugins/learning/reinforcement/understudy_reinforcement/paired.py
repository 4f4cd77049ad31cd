"""Two policies from the same starts, start by start."""

from __future__ import annotations

import math
import statistics
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

from scipy.special import stdtr

from understudy_reinforcement.evaluation import Evaluation, shown_share

__all__ = ["Paired"]

#: A fall is more than chance where chance alone makes one as large less often than this.
CHANCE = 0.05
#: Starts from which on a test can say so, with all of them lost; of fewer any fall counts.
FEWEST = 5
#: Of an objective: falls below this share of it are none, however sure.
SMALL = 0.01


@dataclass(frozen=True)
class Paired:
    """A second policy compared with a first, from the same starts. Each start counts once, however often it was drawn:
    a deterministic policy repeats itself from the same start."""

    of: str  #: what is compared: ``success``, or the name of a measure
    starts: int  #: different ones
    first: float  #: share of starts with success, or mean of the measure
    second: float
    worse: int  #: starts from which the second one succeeds no more, or has less
    better: int
    chance: float  #: how probable a fall as large is, if neither were the better one

    @classmethod
    def of_evaluations(cls, first: Evaluation, second: Evaluation) -> Paired | None:
        """From two evaluations on the same draw; None if they do not tell single episodes apart.

        Success is compared by the sign test (McNemar's, exact and one-sided), a measure by Student's t of the
        differences, one-sided. If the first has a finite number and the second has none, the second counts as the least of all.

        Raises
        ------
        ValueError
            if they are not of equally many episodes.
        """
        by_start: dict[bytes, tuple[float, float]] = {}
        for (start, a), (_, b) in zip(first.outcomes, second.outcomes, strict=True):
            if math.isfinite(a):
                by_start.setdefault(start, (a, b))
        if not by_start:
            return None
        least = min(x for pair in by_start.values() for x in pair if math.isfinite(x))
        pairs = [(a, b if math.isfinite(b) else least) for a, b in by_start.values()]
        of = "success" if first.success_rate is not None else first.compared
        worse, better = sum(b < a for a, b in pairs), sum(b > a for a, b in pairs)
        chance = _sign(worse, better) if of == "success" else _student([b - a for a, b in pairs])
        means = [statistics.fmean(column) for column in zip(*pairs, strict=True)]
        return cls(of, len(pairs), means[0], means[1], worse, better, chance)

    @property
    def can_fall(self) -> bool:
        """Whether a loss could be told from chance: who succeeds from too few starts has too little to lose."""
        needed = FEWEST if self.starts >= FEWEST else 1
        return self.of != "success" or round(self.first * self.starts) >= needed

    @property
    def falls(self) -> bool:
        """Whether the second one is worse by more than chance."""
        least = 0.0 if self.of == "success" else SMALL * abs(self.first)
        if self.first - self.second <= least:
            return False
        return self.starts < FEWEST or self.chance < CHANCE

    def sentence(self) -> str:
        """Both results in one clause, the second first."""
        starts = f"{self.starts} start{'s' * (self.starts != 1)}"
        if self.of != "success":
            text = f"{self.of} {self.second:.4g} instead of {self.first:.4g} from {starts}"
        else:
            text = (
                f"success from {shown_share(self.second)} of {starts} instead of {shown_share(self.first)} "
                f"(lost {self.worse}, won {self.better})"
            )
        if self.falls:
            return f"{text}, a loss" + (
                "" if self.starts < FEWEST else f" beyond chance (p = {self.chance:.2g})"
            )
        if not self.can_fall:
            return f"{text}, too few successes to show a loss"
        if self.of == "success" and self.starts >= FEWEST:
            return f"{text}, no loss is shown; {FEWEST} lost starts would show one"
        return f"{text}, no loss is shown"

    def as_json(self) -> dict[str, Any]:
        return asdict(self)


def _sign(worse: int, better: int) -> float:
    """The probability that at least so many of the differing starts come out worse by chance."""
    n = worse + better
    return sum(math.comb(n, k) for k in range(worse, n + 1)) / 2**n


def _student(differences: Sequence[float]) -> float:
    n = len(differences)
    mean = statistics.fmean(differences)
    error = statistics.stdev(differences) / math.sqrt(n) if n > 1 else 0.0
    if error == 0:
        return 0.0 if mean < 0 else 1.0
    return float(stdtr(n - 1, mean / error))
