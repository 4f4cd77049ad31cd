"""An outer loop of trainings that build on one another, such as skills and a controller above them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

from understudy.errors import ConfigError, suggestion
from understudy_sweeps.loops import OuterLoop, Report, Trial

__all__ = ["Chain"]

_NAMED = re.compile(r"\{(\w+)\}")
_EXPERIMENT = re.compile(r"\+*experiment=")


class Chain(OuterLoop):
    """Stages, each a run of the given overrides, in which ``{NAME}`` is the run folder of the stage NAME.

    A stage begins once all stages that it names are done; one that names none can begin at once. When the same sweep
    is started again, finished stages are not trained again; failed ones are, as ``NAME~2``.
    """

    extendable = ("stages",)
    alike = False  # a stage may judge for seconds, or train for hours

    @dataclass(frozen=True)
    class Options:
        #: by name, the overrides of each
        stages: Mapping[str, tuple[str, ...]] = field(default_factory=dict)
        #: overrides of every stage that names an experiment, before its own
        each: tuple[str, ...] = ()

        def __post_init__(self) -> None:
            if not self.stages:
                raise ValueError("stages={} is not possible: give at least one.")
            if named := _named(self.each):
                raise ValueError(
                    f"each names the stage '{named[0]}': stages name others, each does not."
                )
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
        self._stages = {
            stage: (*options.each, *own) if any(_EXPERIMENT.match(text) for text in own) else own
            for stage, own in options.stages.items()
        }
        self._tries: dict[str, int] = {}
        self._replayed = False
        self._failed: set[str] = set()  #: before this call of the sweep
        self._results: dict[str, Report] = {}
        self.share, self.missing = 0.0, list(self._stages)

    def ask(self, number: int) -> Trial | None:
        if not self._replayed:  # all that the journal knew
            self._replayed = True
            self._failed = {s for s in self._results if not self._done(s)}
        for stage, overrides in self._stages.items():
            wanted = stage not in self._tries or stage in self._failed
            if wanted and all(self._done(name) for name in _named(overrides)):
                self._failed.discard(stage)
                self._tries[stage] = self._tries.get(stage, 0) + 1
                return self._trial(stage)
        return None

    def _done(self, stage: str) -> bool:
        return stage in self._results and self._results[stage].status == "ok"

    def _trial(self, stage: str) -> Trial:
        def folder(match: re.Match[str]) -> str:
            return self._results[match[1]].run

        overrides = tuple(_NAMED.sub(folder, override) for override in self._stages[stage])
        number = self._tries.get(stage, 1)
        return Trial(stage if number == 1 else f"{stage}~{number}", overrides, variant=stage)

    def recall(self, trial: Trial) -> bool:
        stage = _stage_of(trial.key)
        if stage not in self._stages:
            return False
        known = all(self._done(name) for name in _named(self._stages[stage]))
        if known and trial.overrides != self._trial(stage).overrides:
            raise ConfigError(
                f"Stage '{stage}' had other overrides when this sweep began: "
                f"{', '.join(trial.overrides) or 'none'}. Give the new one another name."
            )
        self._tries[stage] = self._tries.get(stage, 0) + 1
        return True

    def tell(self, report: Report) -> None:
        if report.final:
            self._results[_stage_of(report.key)] = report
            self.share = len(self._results) / len(self._stages)
            self.missing = [stage for stage in self._stages if not self._done(stage)]

    def summary(self) -> list[dict[str, Any]]:
        """A row for each stage: its result and its samples."""
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


def _stage_of(key: str) -> str:
    """The stage that the trial `key` tries, for the first time or again."""
    return key.partition("~")[0]


def _named(overrides: tuple[str, ...]) -> list[str]:
    """The stages that these overrides name, in order, each once."""
    return list(dict.fromkeys(name for text in overrides for name in _NAMED.findall(text)))
