"""Trainings that build on one another, as an outer loop: skills, where they end, the controller above."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from understudy.errors import ConfigError, suggestion
from understudy.running.trials import OuterLoop, Report, Trial

_NAMED = re.compile(r"\{(\w+)\}")


class Chain(OuterLoop):
    """Stages, each a run of the given overrides, in which ``{NAME}`` is the run folder of the stage NAME.

    A stage begins once all those that it names are done; those that name none can begin at once. What
    was trained is not trained again when the same sweep is started again.
    """

    extendable = ("stages",)

    @dataclass(frozen=True)
    class Options:
        stages: Mapping[str, tuple[str, ...]] = field(default_factory=dict)

        def __post_init__(self) -> None:
            if not self.stages:
                raise ValueError("stages={} is not possible: give at least one.")
            known: set[str] = set()
            for stage, overrides in self.stages.items():
                for name in _named(overrides):
                    if name not in known:
                        raise ValueError(
                            f"stages.{stage} names '{name}', which is no stage before it."
                            + suggestion(name, known)
                        )
                known.add(stage)

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._stages, self._seed = options.stages, seed
        self._asked: set[str] = set()
        self._results: dict[str, Report] = {}
        self.share = 0.0

    def ask(self, number: int) -> Trial | None:
        for stage, overrides in self._stages.items():
            if stage not in self._asked and all(self._done(name) for name in _named(overrides)):
                self._asked.add(stage)
                return self._trial(stage)
        return None

    def _done(self, stage: str) -> bool:
        return stage in self._results and self._results[stage].status == "ok"

    def _trial(self, stage: str) -> Trial:
        def folder(match: re.Match[str]) -> str:
            return self._results[match[1]].run

        overrides = tuple(_NAMED.sub(folder, override) for override in self._stages[stage])
        return Trial(stage, overrides, variant=stage)

    def recall(self, trial: Trial) -> bool:
        if trial.key not in self._stages:
            return False
        known = all(self._done(name) for name in _named(self._stages[trial.key]))
        if known and trial.overrides != self._trial(trial.key).overrides:
            raise ConfigError(
                f"Stage '{trial.key}' had other overrides when this sweep began: "
                f"{', '.join(trial.overrides)}. Give the new one another name."
            )
        self._asked.add(trial.key)
        return True

    def tell(self, report: Report) -> None:
        if report.final:
            self._results[report.key] = report
            self.share = len(self._results) / len(self._stages)

    def summary(self) -> list[dict[str, Any]]:
        """A row for each stage: what came of it, and its samples."""
        return [
            {
                "stage": stage,
                "status": found.status if (found := self._results.get(stage)) else "not begun",
                "objective": found.objective if found else None,
                "samples": found.cost if found else None,
                "run": found.run if found else None,
            }
            for stage in self._stages
        ]


def _named(overrides: tuple[str, ...]) -> list[str]:
    """The stages that these overrides name, in order, each once."""
    return list(dict.fromkeys(name for text in overrides for name in _NAMED.findall(text)))
