"""Trials as strategies: where each was, the feature that it showed, and which ones are alike."""

from __future__ import annotations

import math
from abc import abstractmethod
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal, Protocol

import numpy as np
import torch
from scipy.cluster.hierarchy import fcluster, linkage
from scipy.spatial.distance import squareform
from torch import Tensor
from torch.nn.functional import normalize

from understudy.errors import ConfigError, suggestion
from understudy.options import check_range
from understudy_bayes.book import Book, SearchOptions
from understudy_bayes.space import Parameter, check_paths
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import OuterLoop, Report, Trial

SUCCESS = "success_rate"
#: Of a feature: larger ones are a simulation's that blew up, and their distances no numbers.
_MOST = 1e30
Metric = Literal["euclidean", "rotation"]


@dataclass(frozen=True)
class Feature:
    """A measure that tells strategies apart, and the range of its values."""

    low: float  #: least value of the feature, in the measure's unit
    high: float  #: greatest value of the feature, in the measure's unit

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(
                f"low={self.low:g} is not possible: it must be less than high={self.high:g}."
            )


@dataclass(frozen=True)
class GalleryOptions:
    """What the gallery shows of a strategy beside its video."""

    #: The measure that says how well a strategy does, by a name of your own; null is the objective.
    best: str | None = None
    best_name: str = ""  #: name of ``best`` on the page
    unit: str = ""  #: unit in which ``best`` is shown
    scale: float = 1.0  #: factor from the measure's unit to ``unit``
    #: Number of the recorded field ``track`` that is greatest at the peak, or nearest to ``at``; null is
    #: mid-way.
    track: str | None = None
    index: int = 0  #: which number of ``track``, from 0
    #: value of ``track``, in its unit, at which the picture is taken; null takes the greatest
    at: float | None = None
    #: names of parameters and features on the page, by what they are called in the configuration
    names: Mapping[str, str] = field(default_factory=dict)


@dataclass(frozen=True)
class Stalled:
    """A trial is hopeless once a figure of its training has not risen for so many samples."""

    figure: str  #: the figure that trials report: curriculum/difficulty, or a measure
    samples: float  #: training samples without a rise after which a trial is ended, above 0
    #: A trial whose figure has come to this is never hopeless: a bar at its target cannot rise.
    until: float | None = None

    def __post_init__(self) -> None:
        check_range(self, "samples", above=0, most=2**53)


class Patience:
    """Says when a trial is hopeless, from what it reports while it runs; None: never."""

    def __init__(self, stalled: Stalled | None) -> None:
        self._stalled = stalled
        self._best: dict[
            str, tuple[float, float]
        ] = {}  #: by trial: the figure, and samples by then

    def over(self, report: Report) -> bool:
        """Whether the trial of this intermediate `report` is hopeless.

        Raises
        ------
        ConfigError
            if it has no such figure.
        """
        if self._stalled is None or report.final:
            return False
        figure = self._stalled.figure
        if figure not in report.measures:
            raise ConfigError(
                f"outer_loop.stalled.figure names '{figure}', which trial '{report.key}' did not "
                f"report.{suggestion(figure, report.measures)}"
            )
        value = report.measures[figure]
        best, since = self._best.get(report.key, (-math.inf, 0.0))
        if value > best:
            self._best[report.key] = (value, report.cost)
            return False
        until = self._stalled.until
        if until is not None and best >= until:
            return False
        return report.cost - since >= self._stalled.samples


@dataclass(frozen=True)
class DiversityOptions:
    """What every diversity search takes."""

    parameters: Mapping[str, Parameter]  #: by option of the configuration, the range to search
    features: Mapping[str, Feature]  #: by measure: f of section 4.5.1
    distinct: float  #: distance of features from which on strategies are different, above 0
    trials: int  #: how many trainings, from 1
    initial: int = 2  #: trials at random points, before a model chooses
    #: Distance of features: of vectors, or the angle in rad between two rotations, whose x axes and
    #: z axes are six features.
    metric: Metric = "euclidean"
    success: float = 0.5  #: success rate from which on a trial shows a strategy
    stalled: Stalled | None = None  #: when a trial is ended early; null is never
    gallery: GalleryOptions = field(default_factory=GalleryOptions)  #: what the gallery shows

    def __post_init__(self) -> None:
        check_paths(self.parameters)
        check_features(self.features, self.metric)
        check_range(self, "distinct", above=0)
        check_range(self, "trials", "initial", least=1)
        check_range(self, "success", least=0, most=1)


class Told(Protocol):
    """What it takes to tell strategies apart."""

    @property
    def features(self) -> Collection[str]: ...  # by measure
    @property
    def distinct(self) -> float: ...
    @property
    def metric(self) -> Metric: ...
    @property
    def success(self) -> float: ...


def check_features(features: Collection[str], metric: Metric) -> None:
    """Raise a ValueError unless there are features, and as many as the metric takes."""
    if not features:
        raise ValueError("features must not be empty: name measures that tell strategies apart.")
    if metric == "rotation" and len(features) != 6:
        raise ValueError(
            f"features has {len(features)} measures: metric=rotation takes six, of a rotation's x axis "
            "and z axis."
        )


def distances(a: Tensor, b: Tensor, metric: Metric) -> Tensor:
    """(…, m, n): between features `a` (…, m, k) and `b` (…, n, k); angles of rotations in rad.

    Two rotations an angle φ apart have matrices that are √8 sin(φ/2) apart.
    """
    if metric == "euclidean":
        return torch.cdist(a, b)
    exact = "donot_use_mm_for_euclid_dist"
    apart = torch.cdist(_completed(a), _completed(b), compute_mode=exact)
    return 2 * torch.asin((apart / 8**0.5).clamp(max=1.0))


def _completed(axes: Tensor) -> Tensor:
    """(…, 9): the matrices, column by column, of the rotations with the x axes and, as far as these are
    not along them, the z axes `axes` (…, 6), by Gram and Schmidt."""
    x, z = axes.split(3, dim=-1)
    x = normalize(x, dim=-1)
    z = normalize(z - (x * z).sum(-1, keepdim=True) * x, dim=-1)
    return torch.cat([x, torch.linalg.cross(z, x), z], dim=-1)


def nearest_rotation(axes: Sequence[float]) -> tuple[float, ...] | None:
    """The x axis and z axis of the rotation nearest to `axes` (6), which are means of such over attempts;
    None where these cancel out.

    A mean of axes, unlike one of quaternions of whatever sign or of rotation vectors, is near to the
    rotations of which it is one wherever these are.
    """
    left, sizes, right = np.linalg.svd(np.reshape(axes, (2, 3)), full_matrices=False)
    return tuple((left @ right).ravel().tolist()) if sizes[-1] > 1e-6 else None


def alike(features: Tensor, distinct: float, metric: Metric) -> list[int]:
    """The group of each of `features` (n, k), 0, 1, … in the order in which they come up.

    Groups are merged while all members of the merged one are nearer than `distinct` to one another
    (agglomerative clustering with complete linkage).
    """
    if len(features) < 2:
        return [0] * len(features)
    apart = distances(features, features, metric)
    apart = (0.5 * (apart + apart.mT)).fill_diagonal_(0.0).numpy()
    tree = linkage(squareform(apart, checks=False), method="complete")
    found = fcluster(tree, np.nextafter(distinct, 0.0), criterion="distance").tolist()
    order = {group: place for place, group in enumerate(dict.fromkeys(found))}
    return [order[group] for group in found]


@dataclass(frozen=True)
class Strategy:
    """A finished trial."""

    trial: Trial
    report: Report
    feature: tuple[float, ...] | None  #: None where it succeeded too rarely to show one
    kind: int | None = None  #: which of the different strategies


@dataclass
class Strategies:
    """The trials of one search."""

    options: DiversityOptions

    def __post_init__(self) -> None:
        options = self.options
        self.book = Book(SearchOptions(options.parameters, options.trials, initial=options.initial))
        self.space = self.book.space
        self._patience = Patience(options.stalled)

    def tell(self, report: Report) -> Literal["stop"] | None:
        """Note a final report; "stop" ends the trial of another one that is hopeless.

        Raises
        ------
        ConfigError
            if it lacks a feature or the figure of ``stalled``, or as :meth:`Book.tell`.
        """
        if report.final and report.status == "ok":
            feature_of(report, self.options)
        self.book.tell(report)
        return "stop" if self._patience.over(report) else None

    def finished(self) -> list[Strategy]:
        """In the order in which they were told, with their kinds."""
        return kinds(
            [(self.book.trials[key], report) for key, report in self.book.reports.items()],
            self.options,
        )

    def summary(self) -> list[dict[str, Any]]:
        """A row for each trial; ``different`` counts the strategies found up to it."""
        finished = {s.trial.key: s for s in self.finished()}
        rows, seen = [], set[int]()
        for key, trial in self.book.trials.items():
            strategy = finished.get(key)
            kind = strategy.kind if strategy else None
            seen |= {kind} - {None}  # type: ignore[operator]
            shown = strategy.feature if strategy else None
            rows.append(
                {
                    "trial": key,
                    **trial.point,
                    **dict(zip(self.options.features, shown or [], strict=False)),
                    "status": strategy.report.status.partition(":")[0] if strategy else "running",
                    "success": strategy.report.measures.get(SUCCESS) if strategy else None,
                    "strategy": None if kind is None else kind + 1,
                    "different": len(seen),
                }
            )
        return rows


class StrategySearch(OuterLoop):
    """A search whose trials are strategies at points of a space; where the next one is, others say."""

    extendable = ("trials", "gallery")

    def __init__(self, options: DiversityOptions) -> None:
        self.strategies, self.measures = Strategies(options), tuple(options.features)

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        return self.strategies.book.ranges

    @abstractmethod
    def place(self, number: int) -> Sequence[float]:
        """Where in the unit cube the trial of this `number` is, (d,)."""

    def ask(self, number: int) -> Trial | None:
        book = self.strategies.book
        return None if book.over(number) else book.ask(number, self.place(number))

    def recall(self, trial: Trial) -> bool:
        return self.strategies.book.recall(trial)

    def tell(self, report: Report) -> Literal["stop"] | None:
        answer = self.strategies.tell(report)
        self.share = self.strategies.book.done
        return answer

    def summary(self) -> list[dict[str, Any]]:
        return self.strategies.summary()


def feature_of(report: Report, options: Told) -> tuple[float, ...] | None:
    """The feature that a trial showed, or None.

    Raises
    ------
    ConfigError
        if it has no such measure.
    """
    for name in options.features:
        if name not in report.measures:
            raise ConfigError(
                f"The feature '{name}' is no measure of trial '{report.key}'."
                f"{suggestion(name, report.measures)}"
            )
    shown = tuple(report.measures[name] for name in options.features)
    succeeded = report.measures.get(SUCCESS, 1.0) >= options.success
    if not succeeded or not all(abs(value) < _MOST for value in shown):  # false for NaN, too
        return None
    return nearest_rotation(shown) if options.metric == "rotation" else shown


def finished_trials(journal: Journal) -> list[tuple[Trial, Report]]:
    """In the order in which they were asked for."""
    reports = journal.finished
    return [(trial, reports[trial.key]) for trial in journal.asked if trial.key in reports]


def kinds(found: Sequence[tuple[Trial, Report]], options: Told) -> list[Strategy]:
    """The finished trials `found` as strategies, those that are alike of one kind."""
    strategies = [
        Strategy(trial, report, feature_of(report, options) if report.status == "ok" else None)
        for trial, report in found
    ]
    shown = [s.feature for s in strategies if s.feature is not None]
    features = torch.tensor(shown, dtype=torch.float64).reshape(len(shown), len(options.features))
    groups = iter(alike(features, options.distinct, options.metric))
    return [
        Strategy(s.trial, s.report, s.feature, None if s.feature is None else next(groups))
        for s in strategies
    ]
