"""What a run iterates. All jobs have budget, checkpoints, progress, resume, sweeps and provenance."""

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
    """What an evaluation found. How episodes are counted, and what else is measured, is the job's."""

    episodes: int
    success: str = ""  #: what a success is, in words
    success_rate: float | None = None  #: None where nothing is defined as success
    mean_episode_seconds: float | None = None
    #: False if it was stopped once success was out of reach; then the rate is the most it could be.
    complete: bool = True

    @property
    def trials(self) -> int:
        """How many of the episodes tell something new; intervals are of these."""
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
        """After so many `samples`; `changed` are overrides with which the run was not trained."""

    @abstractmethod
    def sentence(self) -> str:
        """The result in words."""


class Job(ABC):
    """Reinforcement learning, an auto-encoder, a planner's networks, a harvest of states.

    A component of kind ``job``, built with ``(options, experiment)``; it builds the slots that it
    needs itself, in :meth:`prepare`. Between iterations its whole state is in :meth:`state_dict`.
    """

    device: torch.device

    @abstractmethod
    def prepare(self) -> None:
        """Build and check what iterations need; called once, before anything is written. Evaluating
        what another process learned does without."""

    def watch(self, run: Run | None, tell: Callable[[str], None]) -> None:  # noqa: B027
        """Leave what led to the first numbers that go wrong in the ``faults/`` of `run`, and `tell`
        of it; from now on nothing if that is None."""

    @abstractmethod
    def iterate(self, samples: int) -> dict[str, Any]:
        """One iteration, with `samples` consumed before it: its metrics, among them ``consumed``, how many
        samples it took; where it was not training for a while, ``compiling``, s, is not counted."""

    def finished(self) -> bool:
        """Whether there is nothing left to do, whatever the budget."""
        return False

    def stage(self) -> str:
        """Where it stands, in a few words for the progress line."""
        return ""

    def judging(self) -> str:
        """What an evaluation would be now: an ``evaluation``, which may meet the criterion; one of
        the job's own, by the word with which its draw begins; "" if it is not worth its while."""
        return "evaluation"

    def between(self, row: Mapping[str, Any], progress: Progress) -> Mapping[str, Any]:
        """After each iteration, in every process: what its `row` is to say besides. For an evaluation
        that comes sooner, ``progress.evaluated_at`` is set back."""
        return {}

    @abstractmethod
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Judgement:
        """Judge what was learned on data of the name `draw`, which iterations never use."""

    def record(
        self, draw: str, episodes: int, seconds: float
    ) -> tuple[Judgement, Recording | None]:
        """As :meth:`evaluate`, recording up to `seconds` where there is something to see."""
        return self.evaluate(draw, episodes), None

    def products(self, run: Run) -> None:  # noqa: B027 - most leave only their checkpoint
        """Write what other runs take from this one (a bank of states, say) into the folder."""

    def sources(self) -> Mapping[str, Any]:
        """Where its data came from, with licences."""
        return {}

    def notes(self) -> Sequence[str]:
        """What whoever starts it should know about how it is put together, in sentences."""
        return ()

    def report(self) -> Mapping[str, int]:
        """Counts of what went wrong since the start, by name."""
        return {}

    @abstractmethod
    def state_dict(self) -> State: ...

    @abstractmethod
    def load_state_dict(self, state: State) -> None:
        """Continue from `state`; a RunError names the first difference if it is not of this task."""

    @abstractmethod
    def load_learned(self, state: State, samples: int) -> None:
        """Take what is judged (a policy) from `state`, made after `samples`, without preparing."""

    def forget_worlds(self) -> None:  # noqa: B027
        """Begin new episodes: for processes beside process 0, whose worlds the checkpoint has."""

    def close(self) -> None:  # noqa: B027
        """Release what it holds."""
