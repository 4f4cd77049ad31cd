"""Every variant with every seed."""

from __future__ import annotations

import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from understudy.errors import ConfigError
from understudy_sweeps.loops import OuterLoop, Report, Trial


@dataclass(frozen=True)
class Published:
    """Published numbers to compare with: one per variant, of one figure of the table."""

    caption: str  #: where they are from
    values: Mapping[str, float]  #: the published number of each variant
    of: str = "objective"  #: ``objective``, ``success_rate``, ``samples``, or a measure


class Grid(OuterLoop):
    """Every variant with every seed; all variants with the first seed come first.

    A variant is a name and the overrides that make it. The first one is what the others are compared
    with, seed by seed.
    """

    extendable = ("variants", "seeds", "paper")

    @dataclass(frozen=True)
    class Options:
        #: by name, the overrides that make it: several, one, or none
        variants: Mapping[str, tuple[str, ...] | str | None] = field(
            default_factory=lambda: {"base": ()}
        )
        seeds: tuple[int, ...] = (0,)  #: each variant is trained with every one
        #: numbers that the paper has, shown beside ours; null has none
        paper: Published | None = None

        def __post_init__(self) -> None:
            if not self.variants or not self.seeds:
                raise ValueError("variants and seeds must not be empty.")
            if twice := [seed for seed in self.seeds if self.seeds.count(seed) > 1]:
                raise ValueError(
                    f"seeds has {twice[0]} twice, which is trained once: give another."
                )

    def __init__(self, options: Options, seed: int = 0) -> None:
        variants = {
            name: (given,) if isinstance(given, str) else given or ()
            for name, given in options.variants.items()
        }
        self.plan = tuple(
            Trial(f"{name}/seed{number}", overrides, variant=name, seed=number)
            for number in dict.fromkeys(options.seeds)
            for name, overrides in variants.items()
        )
        self.share = 0.0
        self.paper = options.paper
        self._trials = {trial.key: trial for trial in self.plan}
        self._variants = list(options.variants)
        self._asked: set[str] = set()
        self._results: dict[str, Report] = {}

    def ask(self, number: int) -> Trial | None:
        trial = next((t for t in self.plan if t.key not in self._asked), None)
        if trial is not None:
            self._asked.add(trial.key)
        return trial

    def recall(self, trial: Trial) -> bool:
        self._asked.add(trial.key)
        known = self._trials.get(trial.key)
        if known is not None and known != trial:
            raise ConfigError(
                f"The variant of trial '{trial.key}' had other overrides when this sweep began: "
                f"{', '.join(trial.overrides) or 'none'}. Give the new one another name."
            )
        return known is not None

    def tell(self, report: Report) -> None:
        if report.final:
            self._results[report.key] = report
            self.share = len(self._results.keys() & self._trials.keys()) / len(self._trials)

    def summary(self) -> list[dict[str, Any]]:
        """Per variant: seeds finished, and mean and spread of the objective and samples."""
        rows = []
        for name in self._variants:
            found = [
                self._results[t.key]
                for t in self.plan
                if t.variant == name and t.key in self._results
            ]
            done = [r for r in found if r.objective is not None]
            values = [r.objective for r in done if r.objective is not None]
            samples = [r.cost for r in done]
            rows.append(
                {
                    "variant": name,
                    "seeds": len(done),
                    "failed": len(found) - len(done),
                    "objective": statistics.fmean(values) if values else None,
                    "objective_min": min(values, default=None),
                    "samples": statistics.fmean(samples) if samples else None,
                    "samples_max": max(samples, default=None),
                }
            )
        return rows
