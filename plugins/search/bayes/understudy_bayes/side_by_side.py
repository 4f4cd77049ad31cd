"""Candidates that share one job: k points asked together, trained side by side in groups of worlds, told together.

Wherever a point or an override names a candidate it says ``CANDIDATE``; a job of several has each in turn, by its
name. Initial states deal worlds out to them (``understudy_tensors.groups``), and a measure judges each by
its own worlds (``value_where``, ``where: from_NAME``).
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_bayes.book import SearchOptions, refuse_another
from understudy_bayes.gp_ucb import GPUCB
from understudy_bayes.surrogate import SurrogateOptions
from understudy_sweeps.loops import OuterLoop, Report, Trial

__all__ = ["CANDIDATE", "apart", "reports", "together"]

#: What stands for a candidate's name.
CANDIDATE = "CANDIDATE"


def together(key: str, trials: Mapping[str, Trial], overrides: Sequence[str] = ()) -> Trial:
    """One trial `key` of all `trials`, by candidate; `overrides` are added for each."""
    points: dict[str, float] = {}
    words: list[str] = []
    for name, trial in trials.items():
        points |= {path.replace(CANDIDATE, name): value for path, value in trial.point.items()}
        words += [word.replace(CANDIDATE, name) for word in (*trial.overrides, *overrides)]
    return Trial(key, overrides=tuple(dict.fromkeys(words)), point=points)


def apart(trial: Trial, name: str, key: str, paths: Sequence[str]) -> Trial | None:
    """The candidate `name` of a trial of several, as the trial `key` at `paths`; None if it is not in it."""
    point = {
        path: trial.point[named]
        for path in paths
        if (named := path.replace(CANDIDATE, name)) in trial.point
    }
    return Trial(key, point=point) if len(point) == len(paths) else None


def reports(report: Report, keys: Mapping[str, str], objective: str) -> dict[str, Report]:
    """A final `report` on several as one for each candidate, with the trial `keys` that they are known by.

    `objective` is the measure's name, ``score_CANDIDATE``. A candidate without a figure of its own had no world:
    it counts as failed and cost nothing; the others share the samples.
    """
    found = {
        name: value
        for name in keys
        if math.isfinite(value := report.measures.get(objective.replace(CANDIDATE, name), math.nan))
    }
    if report.status != "ok":
        return {
            name: dataclasses.replace(report, key=key, objective=None, cost=report.cost / len(keys))
            for name, key in keys.items()
        }
    return {
        name: dataclasses.replace(
            report, key=key, objective=found[name], cost=report.cost / len(found)
        )
        if name in found
        else Report(key, "failed: it could not begin.", run=report.run)
        for name, key in keys.items()
    }


class SideBySide(OuterLoop):
    """GP-UCB that asks for several points at once and trains them in one job. Points after the first of a job
    are chosen as if those before had given what the model expects."""

    extendable = ("trials", "budget")

    @dataclass(frozen=True)
    class Options(SearchOptions):
        candidates: int = 4  #: points of a job, 2 or more; they are named c0, c1, …
        #: the measure that judges a candidate, with CANDIDATE in its name
        objective: str = "score_CANDIDATE"
        #: overrides that each candidate adds to its job, with CANDIDATE where its name stands
        overrides: tuple[str, ...] = ()
        #: how the objective is modelled
        surrogate: SurrogateOptions = field(default_factory=SurrogateOptions)

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "candidates", least=2)
            for path in (*self.parameters, self.objective):
                if CANDIDATE not in path:
                    raise ValueError(
                        f"'{path}' is the same for all candidates of a job: say {CANDIDATE} where the name of one "
                        "stands."
                    )

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._options, self._paths = options, tuple(options.parameters)
        shared = {f.name: getattr(options, f.name) for f in dataclasses.fields(GPUCB.Options)}
        self._search = GPUCB(GPUCB.Options(**shared), seed)
        #: By job: the trials in the search of its candidates, in the order in which they were asked.
        self._jobs: dict[str, dict[str, str]] = {}

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        return {path.replace(CANDIDATE, "c0"): ends for path, ends in self._search.ranges.items()}

    def _next(self) -> dict[str, str]:
        """By candidate of the next job: its trial in the search."""
        asked = sum(map(len, self._jobs.values()))
        return {f"c{k}": f"trial{asked + k}" for k in range(self._options.candidates)}

    def ask(self, number: int) -> Trial | None:
        trials: dict[str, Trial] = {}
        keys = self._next()
        for name, key in keys.items():
            trial = self._search.ask(int(key.removeprefix("trial")))
            if trial is None:
                break
            trials[name] = trial
        if not trials:
            return None
        self._jobs[f"job{number}"] = {name: keys[name] for name in trials}
        return together(f"job{number}", trials, self._options.overrides)

    def recall(self, trial: Trial) -> bool:
        refuse_another(trial.key, "job", self._jobs)
        keys = self._jobs.get(trial.key) or self._next()
        found = {
            name: own
            for name, key in keys.items()
            if (own := apart(trial, name, key, self._paths)) is not None
        }
        if not found:
            raise ConfigError(
                f"Trial '{trial.key}' is no job of this search's candidates. Give run.dir another folder."
            )
        self._jobs[trial.key] = {name: keys[name] for name in found}
        return all([self._search.recall(own) for own in found.values()])

    def tell(self, report: Report) -> Literal["stop"] | None:
        if report.final and report.key in self._jobs:
            keys = self._jobs[report.key]
            for own in reports(report, keys, self._options.objective).values():
                self._search.tell(own)
            self.share = self._search.share
        return None

    def summary(self) -> list[dict[str, Any]]:
        """The search's trials, with the job that each was part of."""
        jobs = {key: job for job, keys in self._jobs.items() for key in keys.values()}
        return [{**row, "job": jobs[row["trial"]]} for row in self._search.summary()]
