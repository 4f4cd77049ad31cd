"""The trials of a search: what was asked and told, and the same as data for a model."""

from __future__ import annotations

import math
import statistics
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_bayes.fidelity import Fidelity
from understudy_bayes.space import Parameter, Space, check_paths
from understudy_sweeps.loops import Report, Trial

__all__ = ["Book", "SearchOptions"]


@dataclass(frozen=True)
class SearchOptions:
    """What every search takes. It ends at whichever of ``trials`` and ``budget`` it reaches first."""

    parameters: Mapping[str, Parameter]  #: by option of the configuration, the range to search
    trials: int | None = None  #: how many, those at low fidelities among them
    #: Samples, of all trials together (N_total of algorithm 4).
    budget: float | None = None
    initial: int = 8  #: trials at points that no model chose
    #: Whether those count: false has ``trials`` and ``budget`` begin after them, so that searches whose first
    #: trials cost more are left with as much as others.
    initial_counts: bool = True
    #: C of eq. 6.5: y = objective · exp(-samples / C), so that learning faster is better; null is y =
    #: objective.
    sample_scale: float | None = None
    #: The most that the objective can be. With ``sample_scale`` a trial is stopped once even that would
    #: leave its y below the best of a finished trial at its fidelity; null stops none.
    ceiling: float | None = None
    failed: float | None = None  #: y of a trial without an objective; null is the worst y seen

    def __post_init__(self) -> None:
        check_paths(self.parameters)
        check_range(self, "trials", least=1)
        check_range(self, "budget", "sample_scale", above=0, most=2**53)
        check_range(self, "initial", least=1)
        check_range(self, "ceiling", above=0)
        if self.ceiling is not None and self.sample_scale is None:
            raise ValueError(
                "ceiling needs sample_scale: without it a trial that takes long is no worse."
            )
        if self.trials is None and self.budget is None:
            raise ValueError("trials and budget are both unset: say when the search ends.")


@dataclass(frozen=True)
class Data:
    """n trials: where they are in the unit cube and what they gave, float64."""

    x: Tensor  #: (n, d)
    z: Tensor  #: (n,), the fidelity in [0, 1]; 1 where there is none
    y: Tensor  #: (n,), what is maximised
    cost: Tensor  #: (n,), samples


@dataclass
class Book:
    """The trials of one search, in the order in which they were asked.

    ``fidelity`` is None for a search whose trials are all whole ones.
    """

    options: SearchOptions
    fidelity: Fidelity | None = None
    trials: dict[str, Trial] = field(default_factory=dict)
    reports: dict[str, Report] = field(default_factory=dict)  #: final ones

    def __post_init__(self) -> None:
        self.space = Space(self.options.parameters)
        if (
            self.fidelity is not None
            and (option := self.fidelity.option) in self.options.parameters
        ):
            raise ConfigError(
                f"outer_loop.fidelity.option={option} is not possible: it is among outer_loop.parameters, and a trial has "
                "one value of it. Leave it out of them, or take another fidelity."
            )

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """By option that a trial's point names: the least and the greatest value."""
        return self.space.ranges | (self.fidelity.ranges if self.fidelity is not None else {})

    # ------------------------------------------------------------------ asked

    def ask(
        self,
        number: int,
        x: Sequence[float],
        z: float | None = None,
        start: Mapping[str, Any] | None = None,
    ) -> Trial:
        """Note and return the trial of this `number` at `x` (d,) of the unit cube and fidelity `z`."""
        point, difficulty = self.space.point(x), None
        if self.fidelity is not None and z is not None:
            more, difficulty = self.fidelity.place(z)
            point |= more
        trial = Trial(f"trial{number}", point=point, fidelity=difficulty, start=start)
        self.trials[trial.key] = trial
        return trial

    def recall(self, trial: Trial) -> bool:
        """Note a trial that was asked for before; always wanted. A ConfigError if it is no such trial, or not
        the one that was asked for next."""
        refuse_another(trial.key, "trial", self.trials)
        if self.trials.get(trial.key, trial) != trial or not self.space.has(trial.point):
            raise ConfigError(
                f"Trial '{trial.key}' was at another point when this search began. Give run.dir another "
                "folder."
            )
        self.trials[trial.key] = trial
        return True

    def over(self, number: int) -> bool:
        """Whether nothing more is to be asked for while things are as they are.

        A trial that still runs is counted at the mean cost of those that are finished.
        """
        return self.spent(number) >= 1

    def spent(self, number: int) -> float:
        """Which share of ``trials`` or ``budget``, the larger one, is gone before trial `number`."""
        options, free = self.options, self._free()
        share = 0.0 if options.trials is None else (number - len(free)) / options.trials
        if options.budget is None:
            return share
        costs = [report.cost for report in self.reports.values()]
        running = [trial for trial in self.pending if trial.key not in free]
        ahead = len(running) * statistics.fmean(costs) if costs else 0.0
        return max(share, (self._cost(free) + ahead) / options.budget)

    @property
    def done(self) -> float:
        """Which share of the search is finished, for whoever waits for it."""
        options, free = self.options, self._free()
        counted = [key for key in self.reports if key not in free]
        share = 0.0 if options.trials is None else len(counted) / options.trials
        if options.budget is not None:
            share = max(share, self._cost(free) / options.budget)
        return min(1.0, share)

    def _free(self) -> list[str]:
        """The trials that do not count."""
        return [] if self.options.initial_counts else [*self.trials][: self.options.initial]

    def _cost(self, free: Sequence[str]) -> float:
        """Of all finished trials but those."""
        return sum(report.cost for key, report in self.reports.items() if key not in free)

    @property
    def pending(self) -> list[Trial]:
        """What was asked for and is not finished."""
        return [t for key, t in self.trials.items() if key not in self.reports]

    # ------------------------------------------------------------------- told

    def tell(self, report: Report) -> Literal["stop"] | None:
        """Note a final report; "stop" says that one which still runs cannot be the best any more.

        Raises
        ------
        ConfigError
            if none of the first trials could even begin: the search is at fault, not its points.
        """
        if report.key not in self.trials:
            return None
        if not report.final:
            return "stop" if self._hopeless(report) else None
        self.reports[report.key] = report
        told = list(self.reports.values())
        if len(told) == self.options.initial and all(
            r.status != "ok" and r.cost == 0 for r in told
        ):
            raise ConfigError(
                f"None of the first {len(told)} trials could begin; of '{report.key}', "
                f"{report.status} Correct the search's parameters or the experiment, and give run.dir "
                "another folder."
            )
        return None

    def _hopeless(self, report: Report) -> bool:
        """Whether no objective up to ``ceiling`` would bring y, from now on, to the best seen there."""
        ceiling, scale = self.options.ceiling, self.options.sample_scale
        if ceiling is None or scale is None:
            return False
        z = self.z(self.trials[report.key])
        rivals = [self.y(r) for key, r in self.reports.items() if self.z(self.trials[key]) == z]
        best = max((y for y in rivals if y is not None), default=-math.inf)
        return ceiling * math.exp(-report.cost / scale) < best

    def y(self, report: Report) -> float | None:
        """The objective scaled by eq. 6.5; None where there is no finite one.

        An objective below 0 is not scaled, since that would make it better.
        """
        value, scale = report.objective, self.options.sample_scale
        if report.status != "ok" or value is None or not math.isfinite(value):
            return None
        return value * math.exp(-report.cost / scale) if scale is not None and value > 0 else value

    def z(self, trial: Trial) -> float:
        """The fidelity of `trial` in [0, 1]."""
        return 1.0 if self.fidelity is None else self.fidelity.z(trial)

    def whole(self, key: str) -> bool:
        """Whether the trial `key` gave what it gives at full fidelity: at z = 1, or where the fidelity is a
        budget, of which it had some left when it was done."""
        option = "" if self.fidelity is None else self.fidelity.option
        report = self.reports.get(key)
        left = report is not None and report.outcome in ("criterion", "finished")
        return self.z(self.trials[key]) >= 1 - 1e-9 or (option.startswith("budget.") and left)

    def data(self) -> Data:
        """The finished trials."""
        trials = [self.trials[key] for key in self.reports]
        found = [self.y(report) for report in self.reports.values()]
        worst = min((y for y in found if y is not None), default=0.0)
        failed = worst if self.options.failed is None else self.options.failed
        x, z = self.places(trials)
        return Data(
            x,
            z,
            _tensor([failed if y is None else y for y in found]),
            _tensor([report.cost for report in self.reports.values()]),
        )

    def places(self, trials: Sequence[Trial]) -> tuple[Tensor, Tensor]:
        """Where `trials` are: (n, d) in the unit cube, and fidelities (n,)."""
        x = _tensor([self.space.unit(t.point) for t in trials]).reshape(-1, len(self.space))
        return x, _tensor([self.z(t) for t in trials])

    # ---------------------------------------------------------------- results

    def best(self, whole: bool = True) -> str | None:
        """The trial of the highest y; with `whole`, of those at full fidelity."""
        found = {
            key: y
            for key, report in self.reports.items()
            if (y := self.y(report)) is not None and (not whole or self.whole(key))
        }
        return max(found, key=lambda key: found[key], default=None)

    def summary(self) -> list[dict[str, Any]]:
        """A row for each trial. ``z`` is its fidelity of whatever kind, ``whole`` as above; ``best`` is the
        highest y of a whole trial up to it; ``found`` marks the search's answer, and the highest y of
        all where that is another one (algorithm 4 as printed, which compares values of different
        fidelities); the latter says when there is no answer. ``counts`` is there where the first trials do not."""
        options, answer, highest = self.options, self.best(), self.best(whole=False)
        of_all = "highest y" if answer else "highest y; no trial at full fidelity, so no answer"
        rows, best, free = [], None, self._free()
        for key, trial in self.trials.items():
            report = self.reports.get(key)
            y = None if report is None else self.y(report)
            if y is not None and self.whole(key):
                best = y if best is None else max(best, y)
            rows.append(
                {
                    "trial": key,
                    **trial.point,
                    "fidelity": trial.fidelity,
                    "z": self.z(trial),
                    "whole": self.whole(key),
                    "start": (trial.start or {}).get("trial"),
                    "status": "running" if report is None else report.status.partition(":")[0],
                    "objective": None if report is None else report.objective,
                    "y": y,
                    "samples": None if report is None else report.cost,
                    "best": best,
                    **({} if options.initial_counts else {"counts": key not in free}),
                    "found": "answer" if key == answer else of_all if key == highest else "",
                }
            )
        return rows


def _tensor(values: Sequence[Any]) -> Tensor:
    return torch.tensor(values, dtype=torch.float64)


def refuse_another(key: str, name: str, known: Collection[str]) -> None:
    """Raise ConfigError for the `key` of a trial that follows on those `known`, of which the n-th is called `name` and n: a
    row of another search's would be counted as one of this one's."""
    if key not in known and key != f"{name}{len(known)}":
        raise ConfigError(
            f"Trial '{key}' stands where this search's '{name}{len(known)}' is to be: rows of its journal are another "
            "search's, or some are lost. If there is a journal.jsonl.left-out, mend it by that; else give run.dir "
            "another folder."
        )
