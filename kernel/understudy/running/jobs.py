"""What a run iterates. All jobs have budget, checkpoints, progress, resume, sweeps, provenance."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import torch

from understudy.task import State

if TYPE_CHECKING:
    from understudy.records.recording import Recording
    from understudy.records.runs import Run
    from understudy.running.training import Progress

__all__ = ["Job", "Judgement"]


@dataclass(frozen=True)
class Judgement(ABC):
    """What an evaluation found. The job says how episodes are counted and what else is measured."""

    episodes: int
    success: str = ""  #: what a success is, in words
    success_rate: float | None = None  #: None if no success is defined
    mean_episode_seconds: float | None = None
    #: False if it was stopped as the criterion was out of reach; the rate is then an upper bound.
    complete: bool = True

    @property
    def trials(self) -> int:
        """How many of the episodes are independent, for confidence intervals."""
        return self.episodes

    @property
    @abstractmethod
    def objective_value(self) -> float | None:
        """What searches maximise."""

    @abstractmethod
    def row(self, kind: str = "evaluation") -> dict[str, float]:
        """The figures for a row of metrics, each named KIND/NAME."""

    @abstractmethod
    def as_json(self, samples: int, changed: Sequence[str] = ()) -> dict[str, Any]:
        """As plain data, after `samples`; `changed` are overrides that training did not have."""

    @abstractmethod
    def sentence(self) -> str:
        """The result in words."""


class Job(ABC):
    """Reinforcement learning, an auto-encoder, a planner's networks, a harvest of states.

    A component of kind ``job``, built with ``(options, experiment)``. In :meth:`prepare` it builds
    the slots that it needs. Between iterations its whole state is in :meth:`state_dict`.
    """

    device: torch.device

    @abstractmethod
    def prepare(self) -> None:
        """Build and check what iterations need; called once, before anything is written, and not at
        all to evaluate what another process learned."""

    def watch(self, run: Run | None, tell: Callable[[str], None]) -> None:  # noqa: B027
        """From now on, write what led to the first numbers that go wrong into the ``faults/`` of
        `run`, and `tell` of it; nothing if `run` is None."""

    @abstractmethod
    def iterate(self, samples: int) -> dict[str, Any]:
        """One iteration, after `samples`: its metrics, among them ``consumed``, the samples that it
        took, and perhaps ``compiling``, seconds that do not count as training."""

    def finished(self) -> bool:
        """Whether there is nothing left to do, whatever the budget."""
        return False

    def stage(self) -> str:
        """How far it is, in a few words for the progress line."""
        return ""

    def judging(self) -> str:
        """The kind of an evaluation made now: ``evaluation``, which may meet the criterion; a kind
        of the job's own, which its draws are named after; "" if it would not be worth its time."""
        return "evaluation"

    def between(self, row: Mapping[str, Any], progress: Progress) -> Mapping[str, Any]:
        """Called after each iteration, in every process; returns what to add to its `row`. It may
        set ``progress.evaluated_at`` back, for the next evaluation to come sooner."""
        return {}

    @abstractmethod
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Judgement:
        """Judge what was learned, on data named `draw` that iterations never use."""

    def record(
        self, draw: str, episodes: int, seconds: float
    ) -> tuple[Judgement, Recording | None]:
        """As :meth:`evaluate`, recording up to `seconds` if there is something to see."""
        return self.evaluate(draw, episodes), None

    def products(self, run: Run) -> None:  # noqa: B027 - most leave only their checkpoint
        """Write into the folder what other runs take from this one, such as a bank of states."""

    def sources(self) -> Mapping[str, Any]:
        """Where its data comes from, with licences."""
        return {}

    def notes(self) -> Sequence[str]:
        """What its user should know about this combination of parts, in sentences."""
        return ()

    def report(self) -> Mapping[str, int]:
        """By name: how often something went wrong since the start."""
        return {}

    @abstractmethod
    def state_dict(self) -> State: ...

    @abstractmethod
    def load_state_dict(self, state: State) -> None:
        """Continue from `state`; a RunError names the first misfit of another model or task."""

    @abstractmethod
    def load_learned(self, state: State, samples: int) -> None:
        """Take what is judged (a policy) from `state`, saved after `samples`, without preparing."""

    def forget_worlds(self) -> None:  # noqa: B027
        """Begin new episodes, in another process than 0, whose worlds a checkpoint has."""

    def close(self) -> None:  # noqa: B027
        """Release what it holds."""
