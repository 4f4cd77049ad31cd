"""One reward of several terms: their sum, or their product."""

from __future__ import annotations

import functools
import operator
from collections.abc import Sequence
from typing import Literal

import torch
from torch import Tensor

from understudy.task.terms import Term


class Rewards:
    """Combines the values of reward terms; keeps the least value of each that has an exponent."""

    def __init__(
        self,
        terms: Sequence[Term],
        combine: Literal["sum", "product"],
        num_worlds: int,
        device: torch.device,
    ) -> None:
        self._terms, self._summed = terms, combine == "sum"
        #: By term of a product with an exponent: its least value so far, (N,).
        self.least = {
            term.where: torch.zeros(num_worlds, device=device)
            for term in terms
            if not self._summed and term.weight != 1.0
        }

    def combined(self, values: Sequence[Tensor]) -> tuple[Tensor, dict[str, Tensor]]:
        """The reward of the terms' `values`, each (N,); and by term, its summand or factor."""
        given: dict[str, Tensor] = {}
        for term, value in zip(self._terms, values, strict=True):
            if term.where in self.least:
                self.least[term.where].copy_(torch.fmin(self.least[term.where], value))
            if self._summed:
                value = value * term.weight
            elif term.weight != 1.0:
                value = value**term.weight
            given[term.name] = value
        join = operator.add if self._summed else operator.mul
        return functools.reduce(join, given.values()), given
