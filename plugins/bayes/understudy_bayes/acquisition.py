"""Upper confidence bounds, and where they are highest."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import torch
from torch import Tensor

from understudy_bayes.libraries import BotorchWarning, gen_candidates_scipy
from understudy_bayes.surrogate import Surrogate

#: Of points (m, d) of the unit cube, values (m,).
Acquisition = Callable[[Tensor], Tensor]


def beta(d: int, t: int) -> float:
    """β_t = 0.2 d log(2t) of d dimensions and iteration t = 1, 2, … (section 6.3.2; Kandasamy et al.
    2017)."""
    return 0.2 * d * math.log(2 * t)


def upper_bound(model: Surrogate, weight: float, z: float = 1.0, of: float = 1.0) -> Acquisition:
    """a(x) = μ(x, z) + β^½ σ(x, of), with β = `weight` (eq. 6.3; UCB where both are the same)."""

    def value(x: Tensor) -> Tensor:
        if of == z:
            mean, deviation = model.posterior(x, _everywhere(x, z))
            return mean + math.sqrt(weight) * deviation
        both = torch.cat([_everywhere(x, z), _everywhere(x, of)])
        mean, deviation = model.posterior(x.repeat(2, 1), both)
        return mean[: len(x)] + math.sqrt(weight) * deviation[len(x) :]

    return value


def climb(function: Acquisition, starts: Tensor, steps: int = 100) -> Tensor:
    """Where L-BFGS from the best of `starts` (m, d) within the unit cube comes to: (d,)."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", BotorchWarning)
        found, values = gen_candidates_scipy(
            starts.unsqueeze(1),
            lambda x: function(x.squeeze(1)),  # type: ignore[arg-type]
            lower_bounds=0.0,
            upper_bounds=1.0,
            options={"maxiter": steps},
        )
    return found[values.argmax()].squeeze(0).detach()


def highest(function: Acquisition, candidates: Tensor, count: int) -> Tensor:
    """The `count` points of `candidates` (m, d) at which `function` is highest, (count, d)."""
    with torch.no_grad():
        return candidates[function(candidates).topk(min(count, len(candidates))).indices]


def _everywhere(x: Tensor, z: float) -> Tensor:
    return torch.full((len(x),), z, dtype=x.dtype)
