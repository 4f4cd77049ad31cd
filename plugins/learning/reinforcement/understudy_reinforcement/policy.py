"""Policies, the distributions that they return, and how the policy of an experiment is built."""

from __future__ import annotations

import contextlib
from abc import ABC, abstractmethod
from collections import UserDict
from collections.abc import Callable, Iterator, Mapping
from typing import TYPE_CHECKING, Any

import torch
from torch import Tensor, nn

from understudy.errors import ConfigError
from understudy.random import private_rng
from understudy.setup.config import Experiment
from understudy.task import Context

if TYPE_CHECKING:
    from understudy.random import WorldStreams

__all__ = ["Distribution", "Policy", "build_policy"]


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

    Actor and critic are separate so that learners can give each its own rate. State that is in neither (running
    statistics) counts as the normaliser when another run starts with parts of this one.
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
        """Set scheduled values, such as exploration noise, for `samples` consumed so far."""

    @torch.no_grad()
    def readers(self, observations: Mapping[str, Tensor]) -> dict[str, list[str]]:
        """By observation: which of ``actor`` and ``critic`` read it, found by calling both."""
        found: dict[str, list[str]] = {name: [] for name in observations}
        for who, asked in (("actor", self.distribution), ("critic", self.value)):
            asked(_Noting(observations, who, found))
        return found


class _Noting(UserDict[str, Tensor]):
    """Observations that note in `found` which of them `who` reads."""

    def __init__(
        self, observations: Mapping[str, Tensor], who: str, found: Mapping[str, list[str]]
    ) -> None:
        super().__init__(observations)
        self._who, self._found = who, found

    def __getitem__(self, name: str) -> Tensor:
        if self._who not in self._found[name]:
            self._found[name].append(self._who)
        return super().__getitem__(name)


@contextlib.contextmanager
def enough_memory(what: str) -> Iterator[None]:
    """Inside, running out of memory becomes a :class:`ConfigError`."""
    try:
        yield
    except (MemoryError, RuntimeError) as error:
        if not isinstance(error, MemoryError) and "memory" not in str(error):
            raise
        raise ConfigError(
            f"The {what} asks for more memory than there is. Ask for less: fewer worlds, smaller sizes."
        ) from error


def build_policy(experiment: Experiment, context: Context) -> Policy:
    """The policy; its weights depend only on the seed."""
    with private_rng(context.seed, "policy"), enough_memory("policy"):
        return experiment.need("policy").build(context, like=Policy).to(context.device)
