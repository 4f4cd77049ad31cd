"""Bayesian diversity search (thesis, algorithm 1), and random search beside it."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy import random
from understudy.options import check_range
from understudy_bayes import draws
from understudy_bayes.acquisition import Acquisition
from understudy_diversity.acquisition import by_direct, by_gradient, expected_novelty, uncertainty
from understudy_diversity.strategies import DiversityOptions, Feature, Strategies, StrategySearch
from understudy_diversity.surrogate import Surrogate


class DiversitySearch(StrategySearch):
    """After ``initial`` random trials, ``explore`` at x_{t+1} = argmax σ_t(x), then ``exploit`` at
    x_{t+1} = argmax â(x), and so on.

    A trial that succeeded too rarely to show a strategy, like a trial that still runs, is taken to show
    what the model expects, so that its point is not asked for again.
    """

    @dataclass(frozen=True)
    class Options(DiversityOptions):
        explore: int = 3  #: N_exp, how many trials in a row are where the model is least certain
        #: N_opt, how many trials in a row are where the model expects most novelty
        exploit: int = 3

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "explore", "exploit", least=0)
            if self.explore + self.exploit == 0:
                raise ValueError("explore=0 is not possible with exploit=0: give one of them.")

    def __init__(self, options: Options, seed: int = 0) -> None:
        super().__init__(options)
        self._options, self._seed = options, seed

    def place(self, number: int) -> Sequence[float]:
        options, d = self._options, len(self.strategies.space)
        t = number - options.initial  # how many a model chose before
        made = None if t < 0 else model_of(self.strategies, self._seed, number)
        if made is None:  # there is nothing yet that a model could be of
            return draws.uniform(self._seed, number, d)
        model, found = made
        if t % (options.explore + options.exploit) < options.explore:
            return by_gradient(uncertainty(model), d, self._seed, number).tolist()
        novelty = expected_novelty(model, found, options.metric, self._seed, number)
        succeeds = chance(self.strategies, self._seed, number)
        return by_direct(lambda x: novelty(x) * succeeds(x), d).tolist()


def model_of(strategies: Strategies, seed: int, number: int) -> tuple[Surrogate, Tensor] | None:
    """The surrogate of what the trials showed, and the features (n, k) that count as found; None
    before the first strategy."""
    options, finished = strategies.options, strategies.finished()
    shown = [s for s in finished if s.feature is not None]
    if not shown:
        return None
    x, _ = strategies.book.places([s.trial for s in shown])
    f = torch.tensor([s.feature for s in shown], dtype=torch.float64)
    model = Surrogate(
        x, f, list(options.features.values()), random.derive_seed(seed, f"diversity/fit/{number}")
    )
    others = [s.trial for s in finished if s.feature is None] + strategies.book.pending
    if others:
        f = torch.cat([f, model.believe(strategies.book.places(others)[0])])
    return model, f


def chance(strategies: Strategies, seed: int, number: int) -> Acquisition:
    """How likely trials are to show a strategy: a Gaussian process of whether the trials so far did, within
    [0, 1]; 1 everywhere as long as all of them did."""
    finished = strategies.finished()
    if all(s.feature is not None for s in finished):
        return lambda x: torch.ones(len(x), dtype=x.dtype)
    x, _ = strategies.book.places([s.trial for s in finished])
    shown = torch.tensor([[float(s.feature is not None)] for s in finished], dtype=torch.float64)
    fit = random.derive_seed(seed, f"diversity/chance/{number}")
    model = Surrogate(x, shown, [Feature(0.0, 1.0)], fit)
    return lambda x: model.posterior(x)[0][:, 0].clamp(0.0, 1.0)


class RandomDiversity(StrategySearch):
    """Points drawn uniformly, each independently of what the others showed: the baseline."""

    @dataclass(frozen=True)
    class Options(DiversityOptions):
        pass

    def __init__(self, options: Options, seed: int = 0) -> None:
        super().__init__(options)
        self._seed = seed

    def place(self, number: int) -> Sequence[float]:
        return draws.uniform(self._seed, number, len(self.strategies.space))
