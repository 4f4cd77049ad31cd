"""GP-UCB (Srinivas et al. 2010): Bayesian optimisation of whole trials."""

from __future__ import annotations

from dataclasses import dataclass, field

from understudy import random
from understudy_bayes import draws
from understudy_bayes.acquisition import beta, upper_bound
from understudy_bayes.book import Book, SearchOptions
from understudy_bayes.search import BookedSearch
from understudy_bayes.starts import maximise
from understudy_bayes.surrogate import SurrogateOptions, fitted
from understudy_sweeps.loops import Trial

__all__ = ["GPUCB"]


class GPUCB(BookedSearch):
    """x_t = argmax μ(x) + β_t^½ σ(x), after the first trials at points that are spread evenly."""

    @dataclass(frozen=True)
    class Options(SearchOptions):
        #: how the objective is modelled
        surrogate: SurrogateOptions = field(default_factory=SurrogateOptions)

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._options, self._book, self._seed = options, Book(options), seed

    def choose(self, number: int) -> Trial | None:
        book, d = self._book, len(self._book.space)
        if number < self._options.initial:
            return book.ask(number, draws.spread(self._seed, number, d))
        model = fitted(
            book, self._options.surrogate, random.derive_seed(self._seed, f"fit/{number}")
        )
        if model is None:
            return None
        x = maximise(upper_bound(model, beta(d, number + 1)), book, self._seed, number)
        return book.ask(number, x.tolist())
