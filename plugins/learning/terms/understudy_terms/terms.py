"""Terms on any field: ``reads: {value: FIELD}`` says which. Fields are (N,) or (N, …)."""

from __future__ import annotations

import itertools
import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.task import Context
from understudy_tensors.knots import Knots
from understudy_tensors.limits import limits


def _chosen(value: Tensor, index: int | None) -> Tensor:
    """Number `index` of the field's flattened numbers, or all of them."""
    return value if index is None else value.flatten(1)[:, index]


def value(
    value: Tensor,
    *,
    #: which number of a vector, from 0; null only for a field that is one number
    index: int | None = None,
) -> Tensor:
    """The field itself, (N,); for a vector, its number `index`."""
    return _chosen(value, index).float()


def value_where(
    value: Tensor,
    where: Tensor,
    *,
    #: which number of a vector, from 0; null only for a field that is one number
    index: int | None = None,
) -> Tensor:
    """The field, or its number `index`, where the field ``where`` (N,) is not 0; else NaN, (N,).

    An episode that ends with NaN has no value, and means over episodes leave it out.
    """
    return torch.where(where != 0, _chosen(value, index).float(), torch.nan)


@limits(scale=(0, 1e6))
def steady(
    value: Tensor,
    before: Tensor,
    *,
    scale: float,  #: factor of the mean squared difference, per square of the field's unit
) -> Tensor:
    """exp(-scale m), (N,), m the mean square difference of the field's numbers from ``before``, such as its own
    ``previous_``: near 1 if it changes little in a decision."""
    return torch.exp(-scale * (value - before).square().reshape(len(value), -1).mean(dim=1))


@limits(scale=(0, 1e6))
def small(
    value: Tensor,
    *,
    scale: float,  #: factor of the field's size, per its unit
) -> Tensor:
    """exp(-scale ‖value‖), (N,): 1 where the field is 0."""
    return torch.exp(-scale * torch.linalg.vector_norm(value.reshape(len(value), -1), dim=1))


@limits(within=(-1e9, 1e9))
def reached(
    value: Tensor,
    *,
    within: float,  #: greatest value that counts as reached, in the field's unit
    index: int | None = None,  #: which number of a vector is judged, from 0; null judges all
) -> Tensor:
    """The field is at most `within`; for a vector, all its numbers are."""
    return (_chosen(value, index) <= within).view(len(value), -1).all(dim=1)


@limits(limit=(-1e9, 1e9))
def beyond(
    value: Tensor,
    *,
    limit: float,  #: least value that counts as beyond, in the field's unit
    index: int | None = None,  #: which number of a vector is judged, from 0; null judges all
) -> Tensor:
    """The field is at least `limit`; for a vector, any of its numbers is."""
    return (_chosen(value, index) >= limit).view(len(value), -1).any(dim=1)


class OutOfBounds:
    """The field (N,) is below `least` or above `most`, which change with the time since the episode began:
    bounds in space and time about any quantity, as Ma et al. 2021 (section 3.3) put about a reference motion."""

    @dataclass(frozen=True)
    class Options:
        #: points (s, value in the field's unit), in order of time: straight between two, constant beyond the
        #: first and the last; empty: no least
        least: tuple[tuple[float, float], ...] = ()
        most: tuple[tuple[float, float], ...] = ()  #: points likewise; empty: no most

        def __post_init__(self) -> None:
            if not self.least and not self.most:
                raise ValueError("neither least nor most is given: it would never hold. Give one.")
            for name in ("least", "most"):
                points = getattr(self, name)
                if not all(math.isfinite(number) for point in points for number in point):
                    raise ValueError(f"{name} has a number that is not finite.")
                if any(a[0] >= b[0] for a, b in itertools.pairwise(points)):
                    raise ValueError(f"{name}: each point has to be later than the one before it.")

    def __init__(self, options: Options, context: Context) -> None:
        self._least, self._most = (
            Knots(points, context.device) if points else None
            for points in (options.least, options.most)
        )

    def __call__(self, value: Tensor, episode_time: Tensor) -> Tensor:
        out = torch.zeros_like(value, dtype=torch.bool)
        if self._least is not None:
            out |= value < self._least.at(episode_time)
        if self._most is not None:
            out |= value > self._most.at(episode_time)
        return out
