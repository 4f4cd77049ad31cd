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

    def watch(self, on_fault: Callable[[str, State], None] | None) -> None:  # noqa: B027
        """Hand the first numbers that go wrong, as (name, state), to `on_fault` for replay."""

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

    def promising(self) -> bool:
        """Whether an evaluation now may meet the criterion."""
        return True

    def coarse(self) -> bool:
        """Whether iterations simulate more coarsely than what they are judged by."""
        return False

    def sharpen(self) -> str:
        """Switch to the physics that counts; returns what it is, in a few words. Only if `coarse`."""
        raise NotImplementedError

    def rehearse(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Judgement:
        """As :meth:`evaluate`, at the coarse physics. Only if `coarse`."""
        raise NotImplementedError

    @abstractmethod
    def evaluate(
        self, draw: str, episodes: int, *, give_up_below: float | None = None
    ) -> Judgement:
        """Judge what was learned on data of the name `draw`, which iterations never use."""

    def evaluate_finer(self, draw: str, episodes: int) -> tuple[float, Judgement] | None:
        """As :meth:`evaluate`, at half the time step of physics; and that physics' rate in Hz.
        None where there is no physics."""
        return None

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
        """Continue from `state`.

        Raises
        ------
        RunError
            if it belongs to another model, task or number of worlds; names the first
            difference.
        """

    @abstractmethod
    def load_learned(self, state: State, samples: int) -> None:
        """Take what is judged (a policy) from `state`, made after `samples`, without preparing."""

    def forget_worlds(self) -> None:  # noqa: B027
        """Begin new episodes: for processes beside process 0, whose worlds the checkpoint has."""

    def close(self) -> None:  # noqa: B027
        """Release what it holds."""
