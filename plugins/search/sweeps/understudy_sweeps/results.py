"""The results of a sweep's trials, read from its journal and their run folders."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

from understudy.records.runs import Run
from understudy_reinforcement.evaluation import wilson_interval
from understudy_report.values import Row, interval, mapping, number, own_evaluation
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.trial import folder_of

__all__ = ["OBJECTIVE", "SAMPLES", "SECONDS", "SUCCESS", "Result", "Results"]

#: Figures of every trial beside its measures.
SUCCESS, OBJECTIVE, SAMPLES, SECONDS = "success_rate", "objective", "samples", "seconds"
#: Before the name of a training's metric: a figure of its last value.
METRICS = "metrics/"
#: The share of episodes whose numbers went wrong, a measure of the trials that had some.
UNSOUND = "unsound"


@dataclass(frozen=True)
class Result:
    """A trial that was asked for, and its result, if there is one."""

    trial: Trial
    report: Report | None  #: the final one
    path: Path  #: its run folder
    rows: Sequence[Row] = ()  #: its metrics
    evaluation: Row = field(default_factory=dict)  #: its last one
    #: The loop's own row of it. What the loop maximises may be another figure than the objective (``y``, such
    #: as eq. 6.5's), only some trials can be its answer (``whole``), and it says which one is (``found``).
    said: Row = field(default_factory=dict)

    @property
    def ok(self) -> bool:
        return self.report is not None and self.report.status == "ok"

    @property
    def state(self) -> str:
        """How far it is, in a word; or why it failed."""
        if self.report is None:
            return "unfinished"
        return self.report.outcome or self.report.status

    @property
    def seconds(self) -> float | None:
        """Of training, over all resumes."""
        return self._last(SECONDS)

    def _last(self, name: str) -> float | None:
        """The last value of a metric."""
        return next(
            (x for row in self.rows[::-1] if (x := number(row.get(name))) is not None), None
        )

    @property
    def worth(self) -> float | None:
        """The value by which a search ranks it; None if it failed."""
        objective = self.figure(OBJECTIVE)
        return objective if objective is None else number(self.said.get("y", objective))

    def figure(self, name: str) -> float | None:
        """``objective``, ``samples``, ``seconds``, a measure, or ``metrics/NAME``, the last value of that
        metric; None where it has none."""
        if self.report is None or not self.ok:
            return None
        if name.startswith(METRICS):
            return self._last(name.removeprefix(METRICS))
        found = {OBJECTIVE: self.report.objective, SAMPLES: self.report.cost, SECONDS: self.seconds}
        none = 0.0 if name == UNSOUND else None
        return number(found.get(name, self.report.measures.get(name, none)))


class Results:
    """Reads what the journal names; a finished trial is read only once."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        self._finished: dict[str, Result] = {}

    def of(self, journal: Journal, summary: Sequence[Row] = ()) -> list[Result]:
        """In the order in which they were asked for; `summary` are the outer loop's rows."""
        reports = journal.finished
        return told([self._one(trial, reports.get(trial.key)) for trial in journal.asked], summary)

    def _one(self, trial: Trial, report: Report | None) -> Result:
        if trial.key in self._finished:
            return self._finished[trial.key]
        path = folder_of(trial.key, self._folder)
        run = Run(path, {})
        result = Result(trial, report, path, run.metrics(), own_evaluation(run))
        if report is not None:
            self._finished[trial.key] = result
        return result


@dataclass(frozen=True)
class Variant:
    """The results of one variant."""

    name: str
    results: Sequence[Result]

    def figures(self, name: str) -> dict[int, float]:
        """The values by seed."""
        found = {r.trial.seed or 0: r.figure(name) for r in self.results}
        return {seed: value for seed, value in found.items() if value is not None}


def variants_of(results: Sequence[Result]) -> list[Variant]:
    """In the order in which they were asked for; empty if the sweep is no comparison of variants."""
    names = dict.fromkeys(r.trial.variant for r in results if r.trial.variant)
    return [Variant(n, [r for r in results if r.trial.variant == n]) for n in names]


def measures_of(results: Sequence[Result]) -> list[str]:
    """The names of all measures, success first."""
    names = {name for r in results if r.report for name in r.report.measures}
    return sorted(names, key=lambda name: (name != SUCCESS, name))


def shares_of(results: Sequence[Result]) -> frozenset[str]:
    """The names of measures that are shares of episodes, as their intervals in the evaluations say: those
    of other means are not Wilson's."""
    found: dict[str, bool] = {SUCCESS: True, UNSOUND: True}
    for result in results:
        episodes = int(number(result.evaluation.get("episodes")) or 0)
        trials = min(episodes, int(number(result.evaluation.get("different_starts")) or episodes))
        for name, said in mapping(result.evaluation.get("measures")).items():
            mean, bounds = number(mapping(said).get("mean")), interval(mapping(said).get("mean_95"))
            if mean is not None and bounds is not None:
                share = 0.0 <= mean <= 1.0 and (
                    mapping(said).get("reduce") == "any"
                    or any(
                        math.dist(bounds, wilson_interval(mean, n)) < 1e-9
                        for n in (trials, episodes)
                    )
                )
                found[name] = found.get(name, True) and share
    return frozenset(name for name, share in found.items() if share)


def objective_of(results: Sequence[Result]) -> str:
    """What the objective is."""
    for result in results:
        name = mapping(result.evaluation).get("objective")
        if isinstance(name, Mapping) and isinstance(name.get("name"), str):
            return name["name"]
    return OBJECTIVE


def told(results: Sequence[Result], summary: Sequence[Row]) -> list[Result]:
    """The `results` with what the rows of an outer loop's `summary` say; a trial of several candidates, whose rows name it as
    their ``job``, as one for each."""
    of_jobs: dict[str, list[Row]] = {}
    for row in summary:
        if "job" in row:
            of_jobs.setdefault(str(row["job"]), []).append(row)
    said = {str(row["trial"]): row for row in summary if "trial" in row and "job" not in row}
    found: list[Result] = []
    for result in results:
        if candidates := of_jobs.get(result.trial.key):
            found += [_candidate(result, row) for row in candidates]
        else:
            found.append(replace(result, said=said.get(result.trial.key, {})))
    return found


def _candidate(job: Result, row: Row) -> Result:
    """One of a `job`, by its own row: what was measured of all together is not its."""
    point = {k: float(v) for k, v in row.items() if "." in k}  # options of the configuration
    trial, report = Trial(str(row["trial"]), point=point), job.report
    if report is not None:
        failed = "failed: it could not begin in its job."
        report = replace(
            report,
            key=trial.key,
            status="ok"
            if row["status"] == "ok"
            else failed
            if report.status == "ok"
            else report.status,
            objective=row["objective"],
            measures={},
            cost=row["samples"] or 0.0,
        )
    return replace(job, trial=trial, report=report, rows=(), said=row)


def compared_in(results: Sequence[Result]) -> list[Result]:
    """The finished trials of a search whose worth can be compared: those that the loop calls whole, or
    else those of the greatest fidelity."""
    done = [r for r in results if r.worth is not None]
    if any("whole" in r.said for r in results):
        return [r for r in done if r.said.get("whole")]
    top = max((r.trial.fidelity for r in done if r.trial.fidelity is not None), default=None)
    return [r for r in done if r.trial.fidelity == top]


def best_of(results: Sequence[Result]) -> Result | None:
    """The trial that is worth most, of those that can be compared; None before there is one."""
    return max(compared_in(results), key=lambda r: r.worth or 0.0, default=None)
