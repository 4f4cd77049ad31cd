"""Upper confidence bounds, and where they are highest."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable

import torch
from torch import Tensor

from understudy_bayes.libraries import gen_candidates_scipy
from understudy_bayes.surrogate import Surrogate

__all__ = ["Acquisition", "beta", "climb", "highest", "upper_bound"]

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


def climb(
    function: Acquisition,
    starts: Tensor,
    steps: int = 100,
    within: float | None = None,
    of: Tensor | None = None,
) -> Tensor:
    """Where L-BFGS from the best of `starts` (m, d) within the unit cube comes to, (d,); in no
    dimension farther than `within` from `of` (m, d), which are as near to the starts; by default the starts."""
    if within is None:
        found, values = _ascended(function, starts, 0.0, 1.0, steps)
    else:  # BoTorch takes one box for all starts
        centres = starts if of is None else of
        low, high = (centres - within).clamp(min=0.0), (centres + within).clamp(max=1.0)
        ends = [
            _ascended(function, start.unsqueeze(0), low[i], high[i], steps)
            for i, start in enumerate(starts)
        ]
        found, values = (torch.cat(part) for part in zip(*ends, strict=True))
    return found[values.argmax()].squeeze(0).detach()


def _ascended(
    function: Acquisition, starts: Tensor, low: float | Tensor, high: float | Tensor, steps: int
) -> tuple[Tensor, Tensor]:
    """L-BFGS from each of `starts` (m, d) between `low` and `high`: points (m, 1, d), values (m,)."""
    # BoTorch shows warnings of a failed line search whatever the filter; at the edge of a whole number one fails.
    with warnings.catch_warnings(record=True):
        return gen_candidates_scipy(
            starts.unsqueeze(1),
            lambda x: function(x.squeeze(1)),  # type: ignore[arg-type]
            lower_bounds=low,
            upper_bounds=high,
            options={"maxiter": steps},
        )


def highest(function: Acquisition, candidates: Tensor, count: int) -> Tensor:
    """The `count` points of `candidates` (m, d) at which `function` is highest, (count, d)."""
    with torch.no_grad():
        return candidates[function(candidates).topk(min(count, len(candidates))).indices]


def _everywhere(x: Tensor, z: float) -> Tensor:
    return torch.full((len(x),), z, dtype=x.dtype)
