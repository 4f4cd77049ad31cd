"""``understudy diversity count``: how many different strategies finished searches found."""

from __future__ import annotations

import argparse
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from understudy.command.command import Command
from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_diversity.strategies import Metric, check_features, finished_trials, kinds
from understudy_sweeps.intervals import mean_of
from understudy_sweeps.journal import Journal
from understudy_sweeps.tables import Table


@dataclass(frozen=True)
class _Measure:
    """What strategies are told apart by."""

    distinct: float
    features: tuple[str, ...]
    metric: Metric
    success: float


class Count(Command):
    """Counts the different strategies of searches from their journals, by any measures and distances, and
    gives the mean over searches with its 95 % interval (Student's t): the counts of several seeds."""

    example = "understudy diversity count runs/vault --by 0.35 angle"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("folder", nargs="+", help="folder of a search")
        for name, what in (
            ("by", "strategies differ where these measures are DISTINCT apart or more"),
            (
                "by-rotation",
                "the same for a rotation: DISTINCT in rad, and the six measures of its x axis and z axis",
            ),
        ):
            parser.add_argument(
                f"--{name}", nargs="+", action="append", default=[],
                metavar=("DISTINCT", "MEASURE"), help=what,
            )  # fmt: skip
        parser.add_argument(
            "--success",
            type=float,
            default=0.5,
            metavar="SHARE",
            help="least share of successful attempts with which a trial counts (default: 0.5)",
        )

    def run(self, options: argparse.Namespace) -> int:
        measures = [_measure(words, "euclidean", options.success) for words in options.by]
        measures += [_measure(words, "rotation", options.success) for words in options.by_rotation]
        if not measures:
            raise ConfigError(
                "Say by which measures strategies differ: --by DISTINCT MEASURE … or --by-rotation."
            )
        counts = [_counts(folder, measures) for folder in options.folder]
        heads = ["search", "trials", *(f"by {m.features[0]}, {m.distinct:g}" for m in measures)]
        rows = [
            [folder, *map(str, row)] for folder, row in zip(options.folder, counts, strict=True)
        ]
        rows.append(["mean", *map(_mean, zip(*counts, strict=True))])
        print(Table(heads, rows).text())
        return 0


def _measure(words: Sequence[str], metric: Metric, success: float) -> _Measure:
    try:
        measure = _Measure(float(words[0]), tuple(words[1:]), metric, success)
        check_range(measure, "distinct", above=0, most=1e30)
        check_range(measure, "success", least=0, most=1)
        check_features(measure.features, metric)
    except ValueError as error:
        raise ConfigError(f"'{' '.join(words)}' is no distance and measures: {error}") from error
    return measure


def _counts(folder: str, measures: Sequence[_Measure]) -> list[int]:
    """How many trials are finished, then by each of `measures` how many strategies they show."""
    path = Path(folder) / "journal.jsonl"
    if not path.is_file():
        raise ConfigError(f"{folder} is no folder of a search (understudy sweep).")
    trials = finished_trials(Journal.read(path))
    shown = [{s.kind for s in kinds(trials, measure)} - {None} for measure in measures]
    return [len(trials), *map(len, shown)]


def _mean(values: Sequence[int]) -> str:
    mean = mean_of(values)
    assert mean is not None
    if mean.low is None or mean.high is None:
        return f"{mean.value:.1f}" + (" (2 searches)" if mean.count == 2 else "")
    return f"{mean.value:.1f} [{mean.low:.1f}, {mean.high:.1f}]"
