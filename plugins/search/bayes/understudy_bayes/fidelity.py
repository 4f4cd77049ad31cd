"""What a trial can be a cheap approximation by: the task's difficulty, or an option such as a budget."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

from understudy_sweeps.loops import Trial

__all__ = ["Fidelity"]

DIFFICULTY = "difficulty"


@dataclass(frozen=True)
class Fidelity:
    """z = 0 is the cheapest trial, z = 1 the one that counts.

    By difficulty (section 6.3.1) trials are trained and judged on an easier task. By another option,
    ``budget.samples`` with low = 500 iterations' samples and high = 7000 iterations', on the same task
    for less long: N(z) = low + (high - low) z (section 6.4.2).
    """

    option: str = DIFFICULTY  #: key of the configuration that goes from ``low`` to ``high``
    low: float = 0.0  #: the option's value in the cheapest trial (z = 0)
    high: float = 1.0  #: its value in the trial that counts (z = 1)
    integer: bool = False  #: whether the option takes whole numbers only

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(
                f"low={self.low:g} is not possible: it must be less than high={self.high:g}."
            )
        if self.integer and not (float(self.low).is_integer() and float(self.high).is_integer()):
            raise ValueError(
                f"integer=true is not possible with low={self.low:g} and high={self.high:g}: "
                "give whole numbers."
            )
        if self.option == DIFFICULTY and not 0 <= self.low < self.high <= 1:
            raise ValueError(
                f"low={self.low:g} with high={self.high:g} is not possible: a task's difficulty lies "
                "in [0, 1]."
            )

    def value(self, z: float) -> float:
        """What the option is at `z` in [0, 1]."""
        if z >= 1:
            return int(self.high) if self.integer else self.high
        value = self.low + (self.high - self.low) * max(z, 0.0)
        return round(value) if self.integer else float(f"{value:.6g}")

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """The least and the greatest value of the option, by its key; nothing for the difficulty."""
        return (
            {} if self.option == DIFFICULTY else {self.option: (self.value(0.0), self.value(1.0))}
        )

    def place(self, z: float) -> tuple[dict[str, float], float | None]:
        """What a trial at `z` has in its point besides the space's options, and its difficulty."""
        value = self.value(z)
        return ({}, value) if self.option == DIFFICULTY else ({self.option: value}, None)

    def z(self, trial: Trial) -> float:
        """The z that `trial` is at."""
        point: Mapping[str, float] = trial.point
        value = trial.fidelity if self.option == DIFFICULTY else point.get(self.option)
        return 1.0 if value is None else (value - self.low) / (self.high - self.low)
