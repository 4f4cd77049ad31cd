"""MAP-Elites (Mouret and Clune 2015) through pyribs, asked trial by trial."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch

from understudy import random
from understudy.options import check_range
from understudy_bayes import draws
from understudy_diversity.strategies import DiversityOptions, StrategySearch

try:
    from ribs.archives import GridArchive
    from ribs.emitters import GaussianEmitter
except ImportError as error:
    raise ImportError("MAP-Elites needs pyribs: pip install 'understudy[ribs]'") from error

#: Cells at most; an archive of them is made for each choice.
_MOST = 1_000_000


class MapElites(StrategySearch):
    """After ``initial`` random trials, a Gaussian step from an elite drawn at random.

    An elite is the trial of the highest objective in its cell of a grid over the features' ranges. The
    archive is made anew from what was told whenever a trial is asked for.
    """

    maximises = True

    @dataclass(frozen=True)
    class Options(DiversityOptions):
        cells: int = 20  #: how many cells the grid has along each feature
        step: float = 0.2  #: standard deviation of a step, as a share of the parameter's range

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "cells", least=2, most=1000)
            check_range(self, "step", above=0)
            if self.cells ** len(self.features) > _MOST:
                raise ValueError(
                    f"cells={self.cells} along each of {len(self.features)} features are more than {_MOST:,} "
                    "cells: give fewer features, such as an angle in place of a rotation, or fewer cells."
                )

    def __init__(self, options: Options, seed: int = 0) -> None:
        super().__init__(options)
        self._options, self._seed = options, seed

    def place(self, number: int) -> Sequence[float]:
        options, d = self._options, len(self.strategies.space)
        elites = self._archive(d)
        if number < options.initial or elites.empty:
            return draws.uniform(self._seed, number, d)
        seed = random.derive_seed(self._seed, f"diversity/elites/{number}") % 2**32
        emitter = GaussianEmitter(
            elites,
            sigma=options.step,
            x0=[0.5] * d,
            bounds=[(0.0, 1.0)] * d,
            batch_size=1,
            seed=seed,
        )
        return emitter.ask()[0].tolist()

    def _archive(self, d: int) -> GridArchive:
        options = self._options
        ranges = [(feature.low, feature.high) for feature in options.features.values()]
        cells = [options.cells] * len(ranges)
        archive = GridArchive(solution_dim=d, dims=cells, ranges=ranges, seed=0)
        shown = [
            s
            for s in self.strategies.finished()
            if s.feature is not None
            and s.report.objective is not None  # which would beat one below 0
        ]
        if shown:
            x, _ = self.strategies.book.places([s.trial for s in shown])
            worth = torch.tensor([s.report.objective for s in shown])
            archive.add(x.numpy(), worth.numpy(), np.array([s.feature for s in shown]))
        return archive
