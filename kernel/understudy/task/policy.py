"""Policies and the distributions that they return."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

from torch import Tensor, nn

if TYPE_CHECKING:
    from understudy.random import WorldStreams


class Distribution(ABC):
    """A batch of action distributions."""

    @abstractmethod
    def sample(self, streams: WorldStreams) -> Tensor:
        """(N, A), one action a world."""

    @abstractmethod
    def mode(self) -> Tensor:
        """(…, A), the deterministic action."""

    @abstractmethod
    def log_prob(self, action: Tensor) -> Tensor:
        """(…,) log density of `action` (…, A)."""

    @abstractmethod
    def entropy(self) -> Tensor:
        """(…,)"""

    @abstractmethod
    def divergence(self, other: Any) -> Tensor:
        """(…,) Kullback-Leibler divergence of `other`, of the same kind, from this one:
        E_self[log self - log other]."""

    @abstractmethod
    def map(self, change: Callable[[Tensor], Tensor]) -> Distribution:
        """The same with `change` of each parameter (…, K), or (K,) if it is one for all."""


class Policy(nn.Module, ABC):
    """Observation to action distribution and value; owns no environment.

    Actor and critic are kept apart so that learners can give them rates; what is in neither (running
    statistics) counts as the normaliser when parts of a run are taken over into another.
    """

    @abstractmethod
    def distribution(self, observations: Mapping[str, Tensor]) -> Distribution:
        """For observations (…, D) by name."""

    @abstractmethod
    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        """(…,) expected discounted return."""

    @abstractmethod
    def actor_parameters(self) -> Iterator[nn.Parameter]: ...

    @abstractmethod
    def critic_parameters(self) -> Iterator[nn.Parameter]: ...

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        """Update running statistics from a rollout's observations (T, N, D)."""

    def schedule(self, samples: int) -> None:
        """Set what follows a schedule (exploration noise) for `samples` consumed so far."""
