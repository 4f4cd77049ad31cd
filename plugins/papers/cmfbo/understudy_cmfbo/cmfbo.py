"""Curriculum-based multi-fidelity Bayesian optimisation (thesis, section 6.3)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import torch
from torch import Tensor

from understudy import random
from understudy.options import check_range
from understudy_bayes import draws
from understudy_bayes.acquisition import beta, climb, highest, upper_bound
from understudy_bayes.book import Book, SearchOptions
from understudy_bayes.fidelity import Fidelity
from understudy_bayes.search import BookedSearch
from understudy_bayes.starts import maximise
from understudy_bayes.surrogate import Surrogate, SurrogateOptions, fitted
from understudy_reinforcement.start import Part
from understudy_sweeps.loops import Trial

Z_MIN, Z_MAX = 0.0, 1.0
SAME = 1e-6  #: of each parameter's range: places that are the same


class CMFBO(BookedSearch):
    """Easy tasks find where to look, and hard tasks are tried only there (algorithms 3 and 4).

    A trial is trained and judged at a difficulty; a trial above the least difficulty begins with the policy of the
    nearest easier trial. The answer is the highest y among the trials at full difficulty: algorithm
    4 returns the highest of all, but an easy task's value says nothing about that of the task itself.
    """

    @dataclass(frozen=True)
    class Options(SearchOptions):
        initial: int = 16  #: trials at z_min, the cheapest, at points that no model chose
        fidelity: Fidelity = field(default_factory=Fidelity)  #: the difficulty from z_min to z_max
        #: ε: how well y must be known at one fidelity before the next is asked about, a standard
        #: deviation as a share of the objective's scale: of ``ceiling`` where the search has one (eq. 6.5 reaches
        #: 1 at most), else of the range of all y seen. 0.02 is section 6.3.2's.
        epsilon: float = 0.02
        #: What share of the noise's standard deviation is always enough, what four trials at one place could tell;
        #: 0 is algorithm 3 as printed.
        noise: float = 0.5
        #: What share of the search's end is for full difficulty, whatever ε says: only trials there can
        #: be the answer. 0 is algorithm 4 as printed.
        reserve: float = 0.25
        #: How far above z_min x_t may be from where its search begins (its place at z_min, and in the
        #: last trials a trial's), a share of each parameter's range, of a logarithmic one's decades
        #: ("close to known high-utility regions", 6.3.2); null leaves it to L-BFGS.
        close: float | None = 0.2
        #: Whether trials above z_min begin with the nearest earlier one's policy (section 6.3.3) …
        transfer: bool = True
        #: … of an easier task alone: one that has learned this very task makes any point look good.
        #: False lets any trial be begun from, as the section has it.
        easier: bool = True
        #: … and with which parts of it.
        parts: tuple[Part, ...] = ("actor", "critic", "normaliser")
        #: how the objective is modelled
        surrogate: SurrogateOptions = field(default_factory=SurrogateOptions)

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "epsilon", "close", above=0)
            check_range(self, "reserve", least=0, most=1)
            check_range(self, "noise", least=0)
            if self.transfer and not self.parts:
                raise ValueError(
                    "parts must not be empty: name what to transfer, or transfer=false."
                )

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._options, self._book, self._seed = options, Book(options, options.fidelity), seed
        self._surrogate = options.surrogate.otherwise(fidelity_scale=1.0, slope=1.0)

    def choose(self, number: int) -> Trial | None:
        """Algorithm 4, one iteration; the Gaussian process is fitted anew to all that was told."""
        book, options = self._book, self._options
        if number < options.initial:
            return book.ask(number, draws.spread(self._seed, number, len(book.space)), Z_MIN)
        model = fitted(book, self._surrogate, random.derive_seed(self._seed, f"fit/{number}"))
        if model is None:
            return None
        last = book.spent(number) >= 1 - options.reserve
        x, z = self._finish(model, number) if last else self._progress(model, number)
        return book.ask(number, x.tolist(), z, self._nearest(model, x, z))

    def _progress(self, model: Surrogate, number: int) -> tuple[Tensor, float]:
        """Algorithm 3: (x_t, z_t), the easiest task about which too little is known."""
        book, weight = self._book, beta(len(self._book.space), number + 1)
        scale = self._options.ceiling or _range(book.data().y)
        enough = self._options.epsilon * scale / model.scale
        enough = max(enough, model.noise * self._options.noise)
        z, close = Z_MIN, self._options.close
        x = maximise(upper_bound(model, weight, z, of=Z_MAX), book, self._seed, number)
        easiest = x.unsqueeze(0)
        while z < Z_MAX and _deviation(model, x, z) < enough:
            z = min(z + model.fidelity_scale, Z_MAX)
            bound = upper_bound(model, weight, z, of=Z_MAX)
            x = climb(bound, x.unsqueeze(0), within=close, of=easiest)
        return x, z

    def _finish(self, model: Surrogate, number: int) -> tuple[Tensor, float]:
        """(x_t, z_max): the trial's place that promises most there, if it was not tried at z_max yet, else x_t by
        L-BFGS from the four that promise most."""
        expected, data = upper_bound(model, 0.0, Z_MAX), self._book.data()
        bound = upper_bound(model, beta(len(self._book.space), number + 1), Z_MAX)
        starts = highest(expected, data.x, 4)
        tried = torch.cat([data.x[data.z >= Z_MAX], self._book.places(self._book.pending)[0]])
        if not bool(((tried - starts[0]).abs().amax(1) < SAME).any()):
            return starts[0], Z_MAX
        return climb(bound, starts, within=self._options.close), Z_MAX

    def _nearest(self, model: Surrogate, x: Tensor, z: float) -> Mapping[str, Any] | None:
        """The policy to begin with: that of the earlier trial most correlated with (x, z)."""
        book, options = self._book, self._options
        done = [book.trials[key] for key, r in book.reports.items() if r.status == "ok"]
        if options.easier:
            done = [trial for trial in done if book.z(trial) < z - 1e-9]
        if not options.transfer or z <= Z_MIN or not done:
            return None
        near = model.correlation(x, torch.tensor(z), *book.places(done)).argmax()
        return {"trial": done[int(near)].key, "parts": list(options.parts)}


def _range(y: Tensor) -> float:
    """Of the values seen (n,); 1 where they are all the same."""
    return float(y.max() - y.min()) or 1.0


def _deviation(model: Surrogate, x: Tensor, z: float) -> float:
    with torch.no_grad():
        return float(model.posterior(x.unsqueeze(0), torch.tensor([z]))[1])
