"""Novel policy seeking from the strategies of an earlier search (thesis, section 4.5.2): stage 2."""

from __future__ import annotations

import json
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_diversity.strategies import (
    SUCCESS,
    Feature,
    GalleryOptions,
    Metric,
    Patience,
    Stalled,
    Strategy,
    check_features,
    feature_of,
    finished_trials,
    kinds,
)
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import OuterLoop, Report, Trial
from understudy_sweeps.trial import folder_of


class NovelPolicies(OuterLoop):
    """From each different strategy of the search in ``search``, ``rounds`` trainings one after the other.

    A training has that strategy's point, begins with its policy, and is rewarded for showing another
    feature than all strategies known by then, the earlier search's and this one's.
    """

    extendable = ("rounds", "gallery")

    @dataclass(frozen=True)
    class Options:
        search: str  #: folder of the finished search
        features: dict[str, Feature]  #: by measure; may be others than the earlier search's
        distinct: float  #: distance of features from which on strategies are different, above 0
        feature_field: str  #: the field that holds the feature at the end of an episode
        rounds: int = 5  #: how many trainings each strategy has, one after the other, from 1
        threshold: float = 1.5707963  #: d_threshold of eq. 4.11, in the features' unit, above 0
        #: distance of features: of vectors, or the angle in rad between two rotations
        metric: Metric = "euclidean"
        success: float = 0.5  #: success rate in [0, 1] from which on a trial shows a strategy
        parts: tuple[str, ...] = ("actor", "critic", "normaliser")  #: taken over from the policy
        stalled: Stalled | None = None  #: when a trial is ended early; null is never
        gallery: GalleryOptions = field(default_factory=GalleryOptions)  #: what the gallery shows

        def __post_init__(self) -> None:
            check_features(self.features, self.metric)
            check_range(self, "distinct", "threshold", above=0)
            check_range(self, "rounds", least=1)
            check_range(self, "success", least=0, most=1)

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._options, self.measures = options, tuple(options.features)
        self._known = known_strategies(options.search, options)
        firsts: dict[int, Strategy] = {}
        for strategy in self._known:
            if strategy.kind is not None:
                firsts.setdefault(strategy.kind, strategy)
        if not firsts:
            raise ConfigError(
                f"outer_loop.search={options.search} has found no strategy to begin with."
            )
        self._firsts = list(firsts.values())
        self._patience = Patience(options.stalled)
        self._trials: dict[str, Trial] = {}
        self._reports: dict[str, Report] = {}

    def ask(self, number: int) -> Trial | None:
        count = len(self._firsts)
        if number >= self._options.rounds * count:
            return None
        first = self._firsts[number % count]
        before = f"trial{number - count}"  # this strategy's round before
        if number >= count and before not in self._reports:
            return None
        found = [list(s.feature) for s in self.strategies() if s.feature is not None]
        options = self._options
        novelty = (
            f"{{name:diversity/novelty,reads:{{feature:{options.feature_field}}},found:{json.dumps(found)},"
            f"threshold:{options.threshold!r},metric:{options.metric}}}"
        )
        trial = Trial(
            f"trial{number}",
            overrides=(*first.trial.overrides, f"++reward.terms.novelty={novelty}"),
            point=first.trial.point,
            start={"run": first.report.run, "parts": list(options.parts)},
        )
        self._trials[trial.key] = trial
        return trial

    def strategies(self) -> list[Strategy]:
        """The earlier search's, then this one's as they were told; alike ones are of one kind."""
        own = [(self._trials[key], report) for key, report in self._reports.items()]
        return kinds([*((s.trial, s.report) for s in self._known), *own], self._options)

    def recall(self, trial: Trial) -> bool:
        if self._trials.get(trial.key, trial) != trial:
            raise ConfigError(
                f"Trial '{trial.key}' was another one when this search began. Give run.dir another folder."
            )
        self._trials[trial.key] = trial
        return True

    def tell(self, report: Report) -> Literal["stop"] | None:
        if report.final and report.key in self._trials:
            if report.status == "ok":
                feature_of(report, self._options)
            self._reports[report.key] = report
            self.share = len(self._reports) / (self._options.rounds * len(self._firsts))
        return "stop" if self._patience.over(report) else None

    def summary(self) -> list[dict[str, Any]]:
        """A row for each trial; ``novel`` where no earlier one, of either search, was of its kind."""
        rows, seen = [], set[int | None]()
        for place, strategy in enumerate(self.strategies()):
            novel = strategy.kind is not None and strategy.kind not in seen
            seen.add(strategy.kind)
            if place < len(self._known):
                continue
            shown = dict(zip(self._options.features, strategy.feature or [], strict=False))
            rows.append(
                {
                    "trial": strategy.trial.key,
                    "from": (strategy.trial.start or {}).get("run"),
                    **strategy.trial.point,
                    **shown,
                    "status": strategy.report.status.partition(":")[0],
                    "success": strategy.report.measures.get(SUCCESS),
                    "strategy": None if strategy.kind is None else strategy.kind + 1,
                    "novel": novel,
                }
            )
        return rows


def known_strategies(folder: str, options: NovelPolicies.Options) -> list[Strategy]:
    """The finished trials of the search in `folder`; their runs are in it, wherever they were made."""
    path = Path(folder) / "journal.jsonl"
    if not path.is_file():
        raise ConfigError(
            f"outer_loop.search={folder} is no folder of a search (understudy sweep)."
        )
    found = finished_trials(Journal.read(path))
    here = [(t, replace(report, run=str(folder_of(t.key, folder)))) for t, report in found]
    return kinds(here, options)
