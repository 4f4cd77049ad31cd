"""Terms on any field: ``reads: {value: FIELD}`` says which. Fields are (N,) or (N, …)."""

from __future__ import annotations

import torch
from torch import Tensor


def _chosen(value: Tensor, index: int | None) -> Tensor:
    """Number `index` of the field's flattened numbers, or all of them."""
    return value if index is None else value.flatten(1)[:, index]


def value(
    value: Tensor,
    *,
    #: which number of a vector; null only of a field that is one number
    index: int | None = None,
) -> Tensor:
    """The field itself, (N,); of a vector its number `index`."""
    return _chosen(value, index).float()


def value_where(
    value: Tensor,
    where: Tensor,
    *,
    #: which number of a vector; null only of a field that is one number
    index: int | None = None,
) -> Tensor:
    """The field, or its number `index`, where the field ``where`` (N,) is not 0; else NaN, (N,).

    An episode that ends with NaN has none, and means over episodes leave it out.
    """
    return torch.where(where != 0, _chosen(value, index).float(), torch.nan)


def steady(
    value: Tensor,
    before: Tensor,
    *,
    #: per square of the field's unit
    scale: float,
) -> Tensor:
    """exp(-scale m), (N,), m the mean square over the field's numbers by which it differs from ``before``, such as its
    own ``previous_``: near 1 where it changes little in a decision."""
    return torch.exp(-scale * (value - before).square().reshape(len(value), -1).mean(dim=1))


def reached(
    value: Tensor,
    *,
    #: in the field's unit
    within: float,
    #: of a vector, the number that is judged; null judges all
    index: int | None = None,
) -> Tensor:
    """The field is at most `within`; of a vector, all its numbers."""
    return (_chosen(value, index) <= within).view(len(value), -1).all(dim=1)


def beyond(
    value: Tensor,
    *,
    #: in the field's unit
    limit: float,
    #: of a vector, the number that is judged; null judges all
    index: int | None = None,
) -> Tensor:
    """The field is at least `limit`; of a vector, any of its numbers."""
    return (_chosen(value, index) >= limit).view(len(value), -1).any(dim=1)
