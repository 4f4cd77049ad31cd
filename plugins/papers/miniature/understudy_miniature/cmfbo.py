"""A search over whole trainings whose fidelity is the difficulty: random, with warm starts.

A real search has a model of the reports in place of the random draws.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy_sweeps.loops import OuterLoop, Report, Trial


class RandomFidelity(OuterLoop):
    """Points drawn uniformly; the fidelity rises from trial to trial.

    The second half of the trials begin with actor, critic and normaliser of the best earlier one. A
    trial whose intermediate reports stay below the best at the same fidelity or a higher one by more than
    ``margin`` is stopped.
    """

    maximises = True

    @dataclass(frozen=True)
    class Options:
        low: Mapping[str, float]  #: by option of the configuration, the least value that is drawn
        #: by option of the configuration, the greatest value that is drawn
        high: Mapping[str, float]
        trials: int = 4  #: how many trainings, from 1
        #: shares of the task's difficulty, from the first trials to the last
        fidelities: tuple[float, ...] = (0.2, 1.0)
        #: how far below the best a trial's objective may stay without being stopped
        margin: float = 0.2

        def __post_init__(self) -> None:
            check_range(self, "trials", least=1)
            check_range(self, "margin", least=0)
            if set(self.low) != set(self.high) or not self.low:
                raise ValueError("high is not possible: it must name the same options as low.")
            for name, low in self.low.items():
                if not low <= self.high[name]:
                    raise ValueError(
                        f"high.{name}={self.high[name]:g} is not possible: it must be at least low.{name}={low:g}."
                    )
            if not self.fidelities or not all(0 <= f <= 1 for f in self.fidelities):
                raise ValueError(f"fidelities={self.fidelities} is not possible: give shares of 1.")

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._options, self._seed = options, seed
        self._trials: dict[str, Trial] = {}
        self._reports: dict[str, Report] = {}  #: final ones
        self._stopped: set[str] = set()

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        return {name: (low, self._options.high[name]) for name, low in self._options.low.items()}

    def _point(self, number: int) -> dict[str, float]:
        """Depends on the seed and the trial's number alone."""
        low, high = self._options.low, self._options.high
        u = WorldStreams(self._seed, f"random/{number}", 1, "cpu").uniform(len(low))[0].tolist()
        return {
            name: round(low[name] + (high[name] - low[name]) * share, 4)
            for name, share in zip(low, u, strict=True)
        }

    @property
    def _best(self) -> Report | None:
        found = [r for r in self._reports.values() if r.objective is not None]
        return max(found, key=lambda r: r.objective or 0.0, default=None)

    def ask(self, number: int) -> Trial | None:
        options = self._options
        if number >= options.trials:
            return None
        best, late = self._best, number >= (options.trials + 1) // 2
        if late and len(self._reports) < number:
            return None  # what it begins from is not known yet
        start = {"trial": best.key, "parts": ["actor", "critic", "normaliser"]} if best else None
        trial = Trial(
            f"trial{number}",
            point=self._point(number),
            fidelity=options.fidelities[number * len(options.fidelities) // options.trials],
            start=start if late else None,
        )
        self._trials[trial.key] = trial
        return trial

    def recall(self, trial: Trial) -> bool:
        # Else rows are another's, or some are lost.
        own = {*self._trials, f"trial{len(self._trials)}"}
        if trial.key not in own or trial.point != self._point(int(trial.key.removeprefix("trial"))):
            raise ConfigError(f"Trial '{trial.key}' was at another point when this search began.")
        self._trials[trial.key] = trial
        return True

    def tell(self, report: Report) -> Literal["stop"] | None:
        if report.final:
            self._reports[report.key] = report
            self.share = len(self._reports) / self._options.trials
            return None
        fidelity = self._trials[report.key].fidelity or 0.0
        rivals = [
            r.objective for r in self._reports.values()
            if r.objective is not None and (self._trials[r.key].fidelity or 0.0) >= fidelity
        ]  # fmt: skip
        if not rivals or report.objective is None:
            return None
        if report.objective < max(rivals) - self._options.margin:
            self._stopped.add(report.key)
            return "stop"
        return None

    def summary(self) -> list[dict[str, Any]]:
        """A row for each trial: its point, fidelity, from which one it began, and what it gave."""
        return [
            {
                "trial": key,
                **trial.point,
                "fidelity": trial.fidelity,
                "start": (trial.start or {}).get("trial"),
                "stopped": key in self._stopped,
                "objective": self._reports[key].objective if key in self._reports else None,
                "samples": self._reports[key].cost if key in self._reports else None,
            }
            for key, trial in self._trials.items()
        ]
