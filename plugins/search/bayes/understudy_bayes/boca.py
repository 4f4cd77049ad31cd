"""BOCA: multi-fidelity optimisation with continuous approximations (Kandasamy et al. 2017)."""

from __future__ import annotations

import math
from dataclasses import dataclass, field

import torch
from torch import Tensor

from understudy import random
from understudy.options import check_range
from understudy_bayes import draws
from understudy_bayes.acquisition import beta, upper_bound
from understudy_bayes.book import Book, Data, SearchOptions
from understudy_bayes.fidelity import Fidelity
from understudy_bayes.search import BookedSearch
from understudy_bayes.starts import maximise
from understudy_bayes.surrogate import Surrogate, SurrogateOptions, fitted
from understudy_sweeps.loops import Trial

#: Fidelities below 1 that are compared.
_GRID = 100


class BOCA(BookedSearch):
    """The point is GP-UCB's at z = 1; the fidelity the cheapest at which something is to be learned:

        x_t = argmax μ(x, 1) + β_t^½ σ(x, 1)
        z_t = the cheapest of {1} ∪ {z: σ(x_t, z) > γ(z), ξ(z) > max ξ / β_t^½}
        γ(z) = κ^½ ξ(z) (λ(z) / λ(1))^q,  q = 1 / (p + d + 2)

    with the information gap ξ(z) = (1 - φ(z, 1)²)^½ of the fidelity's kernel φ, the cost λ, the
    kernel's variance κ (1 here) and p = 1 fidelity. The first trials are at points and fidelities
    spread evenly.
    """

    @dataclass(frozen=True)
    class Options(SearchOptions):
        fidelity: Fidelity = field(default_factory=Fidelity)  #: what makes a trial cheap
        #: λ(0) / λ(1), linear in between; null is learned from what trials cost.
        cost_ratio: float | None = None
        #: how the objective is modelled
        surrogate: SurrogateOptions = field(default_factory=SurrogateOptions)

        def __post_init__(self) -> None:
            super().__post_init__()
            check_range(self, "cost_ratio", above=0, most=1)

    def __init__(self, options: Options, seed: int = 0) -> None:
        self._options, self._book, self._seed = options, Book(options, options.fidelity), seed

    def choose(self, number: int) -> Trial | None:
        book, d = self._book, len(self._book.space)
        if number < self._options.initial:
            *x, z = draws.spread(self._seed, number, d + 1)
            return book.ask(number, x, z)
        model = fitted(
            book, self._options.surrogate, random.derive_seed(self._seed, f"fit/{number}")
        )
        if model is None:
            return None
        weight = beta(d, number + 1)
        point = maximise(upper_bound(model, weight), book, self._seed, number)
        z = torch.arange(_GRID, dtype=torch.float64) / _GRID
        relative = relative_cost(z, book.data(), self._options.cost_ratio)
        return book.ask(number, point.tolist(), cheapest(model, point, z, relative, weight))


def cheapest(model: Surrogate, x: Tensor, z: Tensor, relative: Tensor, weight: float) -> float:
    """z_t for the point `x` (d,) among `z` (m,) in [0, 1), whose costs are λ(z)/λ(1) = `relative`
    (m,), and 1."""
    with torch.no_grad():
        _, deviation = model.posterior(x.expand(len(z), -1), z)
    gap = (1 - torch.exp(-(((z - 1) / model.fidelity_scale) ** 2))).sqrt()
    threshold = gap * relative ** (1 / (1 + len(x) + 2))
    wanted = (deviation > threshold) & (gap > gap.max() / math.sqrt(weight)) & (relative < 1)
    return float(z[wanted][relative[wanted].argmin()]) if wanted.any() else 1.0


def relative_cost(z: Tensor, data: Data, ratio: float | None) -> Tensor:
    """λ(z) / λ(1) (m,) at `z` (m,): linear from `ratio`, or log λ = a + b z fitted to `data`, b ≥ 0.

    Before trials at two fidelities have a cost, it is as in section 6.4.2, a quarter for the easiest.
    """
    known = data.cost > 0
    if ratio is None and len(data.z[known].unique()) > 1:
        design = torch.stack([torch.ones_like(data.z[known]), data.z[known]], dim=1)
        slope = torch.linalg.lstsq(design, data.cost[known].log().unsqueeze(1)).solution[1, 0]
        return torch.exp(slope.clamp(min=0) * (z - 1))
    ratio = 0.25 if ratio is None else ratio
    return ratio + (1 - ratio) * z
