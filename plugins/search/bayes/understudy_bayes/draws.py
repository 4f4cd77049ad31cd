"""Points that depend on the seed and the trial's number alone."""

from __future__ import annotations

import torch
from torch import Tensor
from torch.quasirandom import SobolEngine

from understudy import random

__all__ = ["many", "spread", "uniform"]


def uniform(seed: int, number: int, d: int) -> list[float]:
    """A point (d,) of the unit cube, independent of all others."""
    stream = random.generator(seed, f"search/uniform/{number}")
    return torch.rand(d, dtype=torch.float64, generator=stream).tolist()


def spread(seed: int, number: int, d: int) -> list[float]:
    """The point (d,) of this `number` of a scrambled Sobol' sequence: even in every dimension."""
    engine = SobolEngine(d, scramble=True, seed=random.derive_seed(seed, "search/spread"))
    return engine.fast_forward(number).draw(1, dtype=torch.float64)[0].tolist()


def many(seed: int, number: int, d: int, count: int) -> Tensor:
    """`count` points (count, d) of a scrambled Sobol' sequence of this trial's own."""
    engine = SobolEngine(d, scramble=True, seed=random.derive_seed(seed, f"search/many/{number}"))
    return engine.draw(count, dtype=torch.float64)


def around(seed: int, number: int, centre: Tensor, count: int, width: float) -> Tensor:
    """`count` points (count, d) of the unit cube around `centre` (d,), `width` apart from it."""
    stream = random.generator(seed, f"search/around/{number}")
    shape = (count, len(centre))
    return (centre + width * torch.randn(shape, dtype=torch.float64, generator=stream)).clamp(0, 1)
