"""Every variant with every seed."""

from __future__ import annotations

import itertools
import statistics
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from understudy.outer.trials import OuterLoop, Result, Trial


class Grid(OuterLoop):
    """Every variant with every seed. A variant is a name and the overrides that make it."""

    @dataclass(frozen=True)
    class Options:
        variants: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"base": ()})
        seeds: tuple[int, ...] = (0,)

        def __post_init__(self) -> None:
            if not self.variants or not self.seeds:
                raise ValueError("variants and seeds must not be empty.")

    def __init__(self, options: Options, context: None = None) -> None:
        self._pending = [
            Trial(f"{name}/seed{seed}", (*overrides, f"seed={seed}"))
            for (name, overrides), seed in itertools.product(
                options.variants.items(), options.seeds
            )
        ]
        self._variants = list(options.variants)
        self._results: dict[str, Result] = {}

    def ask(self) -> Trial | None:
        return next((t for t in self._pending if t.key not in self._results), None)

    def tell(self, result: Result) -> None:
        self._results[result.key] = result

    def summary(self) -> list[dict[str, Any]]:
        """Per variant: seeds finished, and mean and spread of success rate and samples."""
        rows = []
        for name in self._variants:
            found = [r for k, r in self._results.items() if k.split("/seed")[0] == name]
            done = [r for r in found if r.objective is not None]
            values = [r.objective for r in done if r.objective is not None]
            samples = [r.cost for r in done]
            rows.append(
                {
                    "variant": name,
                    "seeds": len(done),
                    "failed": len(found) - len(done),
                    "success_rate": statistics.fmean(values) if values else None,
                    "success_rate_min": min(values, default=None),
                    "samples": statistics.fmean(samples) if samples else None,
                    "samples_max": max(samples, default=None),
                }
            )
        return rows
