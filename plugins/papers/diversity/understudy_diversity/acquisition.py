"""What is maximised to choose the next trial (section 4.5.1), over the unit cube."""

from __future__ import annotations

import numpy as np
import torch
from scipy.optimize import direct
from torch import Tensor

from understudy import random
from understudy_bayes import draws
from understudy_bayes.acquisition import Acquisition, climb, highest
from understudy_diversity.strategies import Metric, distances
from understudy_diversity.surrogate import Surrogate

#: Draws of the Monte-Carlo estimate, and the most points at which DIRECT looks.
DRAWS, LOOKS = 128, 800


def expected_novelty(
    model: Surrogate, found: Tensor, metric: Metric, seed: int, number: int
) -> Acquisition:
    """â(x) = E[min_i ‖f̂ - f_i‖], f̂ ~ N(μ_t(x), σ_t²(x)), over the features `found` (n, k) (eq. 4.6).

    The same standard normal draws are used at all x, so that what is estimated is a function.
    """
    stream = random.generator(seed, f"diversity/novelty/{number}")
    drawn = torch.randn(DRAWS, found.shape[1], dtype=torch.float64, generator=stream)

    def value(x: Tensor) -> Tensor:
        mean, deviation = model.posterior(x)
        f = mean[:, None] + deviation[:, None] * drawn
        return distances(f, found, metric).amin(-1).mean(-1)

    return value


def uncertainty(model: Surrogate) -> Acquisition:
    """a_exp(x) = σ_t(x) (eq. 4.8); of several features the length of the vector."""

    def value(x: Tensor) -> Tensor:
        return model.posterior(x)[1].norm(dim=-1)

    return value


def by_direct(function: Acquisition, d: int) -> Tensor:
    """The point (d,) at which DIRECT finds `function` highest (Jones et al. 1993)."""

    def loss(u: np.ndarray) -> float:
        with torch.no_grad():
            return -float(function(torch.from_numpy(u).reshape(1, d)))

    bounds = [(0.0, 1.0)] * d
    found = direct(loss, bounds, maxfun=LOOKS, vol_tol=0.0, len_tol=1e-3, locally_biased=False)
    return torch.from_numpy(found.x)


def by_gradient(function: Acquisition, d: int, seed: int, number: int) -> Tensor:
    """The point (d,) to which L-BFGS comes from the best of many starts."""
    return climb(function, highest(function, draws.many(seed, number, d, 256), 8))
