"""Every variant with every seed."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from understudy.errors import ConfigError
from understudy.running.trials import OuterLoop, Report, Trial


class Grid(OuterLoop):
    """Every variant with every seed. A variant is a name and the overrides that make it."""

    extendable = ("variants", "seeds")

    @dataclass(frozen=True)
    class Options:
        variants: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"base": ()})
        seeds: tuple[int, ...] = (0,)

        def __post_init__(self) -> None:
            if not self.variants or not self.seeds:
                raise ValueError("variants and seeds must not be empty.")

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._trials = {
            f"{name}/seed{seed}": Trial(f"{name}/seed{seed}", (*overrides, f"seed={seed}"))
            for (name, overrides), seed in itertools.product(
                options.variants.items(), options.seeds
            )
        }
        self._variants = list(options.variants)
        self._asked: set[str] = set()
        self._results: dict[str, Report] = {}

    def ask(self, number: int) -> Trial | None:
        trial = next((t for k, t in self._trials.items() if k not in self._asked), None)
        if trial is not None:
            self._asked.add(trial.key)
        return trial

    def recall(self, trial: Trial) -> bool:
        self._asked.add(trial.key)
        known = self._trials.get(trial.key)
        if known is not None and known != trial:
            raise ConfigError(
                f"The variant of trial '{trial.key}' had other overrides when this sweep began: "
                f"{', '.join(trial.overrides)}. Give the new one another name."
            )
        return known is not None

    def tell(self, report: Report) -> None:
        if report.final:
            self._results[report.key] = report

    def summary(self) -> list[dict[str, Any]]:
        """Per variant: seeds finished, and mean and spread of the objective and samples."""
        rows = []
        for name in self._variants:
            found = [r for k, r in self._results.items() if k.rpartition("/seed")[0] == name]
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
