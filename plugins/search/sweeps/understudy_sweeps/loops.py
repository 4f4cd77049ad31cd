"""Interfaces for loops around whole trainings: trials and reports, which are data, outer loops and executors."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

__all__ = ["Executor", "OuterLoop", "Report", "Trial", "Work"]


@dataclass(frozen=True)
class Trial:
    """One run that an outer loop asks for, as data.

    ``start`` begins it from parts of another run: ``{"run": PATH, "parts": [...]}``, or ``{"trial":
    KEY, ...}`` for an earlier trial of the same loop.
    """

    key: str  #: its name, unique in the sweep
    overrides: tuple[str, ...] = ()  #: of the configuration that all trials share
    point: Mapping[str, float] = field(default_factory=dict)  #: where in the search space
    fidelity: float | None = None  #: the difficulty in [0, 1] that it is trained and judged at
    start: Mapping[str, Any] | None = None
    initial_states: str | None = None  #: a bank of states to begin episodes in
    variant: str = ""  #: what is compared, over trials that differ in the seed alone
    seed: int | None = None  #: in place of the sweep's


@dataclass(frozen=True)
class Report:
    """The result of a trial so far (status ``running``) or in the end (``ok``, or why it has none)."""

    key: str
    status: str
    objective: float | None = None  #: ``evaluation.objective``, which searches maximise
    measures: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0  #: samples consumed
    run: str = ""  #: its run folder
    outcome: str = ""  #: why its training ended: criterion, budget, finished, or stopped early

    @property
    def final(self) -> bool:
        return self.status != "running"


class OuterLoop(ABC):
    """Proposes trials and learns from reports. Its state is what it was told: replaying that resumes it.

    Built with ``(options, seed)``. Random draws for a trial depend only on the seed and the trial's number
    (``random.generator(seed, f"NAME/{number}")``), so that a resumed loop repeats itself.
    """

    extendable: tuple[str, ...] = ()  #: options that may grow and leave it the same loop
    plan: Sequence[Trial] = ()  #: all trials, where they are known: checked before the first starts
    measures: Sequence[str] = ()  #: that it needs of each report: looked for before the first trial
    maximises: bool = (
        False  #: whether it needs the objective of each report: looked for before the first trial
    )
    missing: Sequence[str] = ()  #: what it was to do and could not: with any, a sweep's status is 1
    share: float | None = None  #: of the loop that is done, where that can be said
    #: Whether as much of it takes as long again, so that the time left can be told.
    alike: bool = True

    @property
    def ranges(self) -> Mapping[str, tuple[float, float]]:
        """By option of the configuration that it chooses values of, the least and the greatest: looked at before the first
        trial."""
        return {}

    @abstractmethod
    def ask(self, number: int) -> Trial | None:
        """The trial of this `number` (0, 1, …), or None while there is nothing to ask for; once all reports were told, None is
        for good."""

    @abstractmethod
    def recall(self, trial: Trial) -> bool:
        """Note a trial that was asked for before this process began; returns whether it is still wanted if it is not finished.
        A ConfigError if the loop knows another trial by that key."""

    @abstractmethod
    def tell(self, report: Report) -> Literal["stop"] | None:
        """Learn from a report; if it is an intermediate one, returning "stop" ends that trial early."""

    @abstractmethod
    def summary(self) -> list[dict[str, Any]]:
        """Rows of a table of the findings so far."""


@dataclass(frozen=True)
class Work:
    """What the trials of a sweep share."""

    overrides: tuple[str, ...]  #: the configuration that a trial's own overrides change
    folder: str  #: where the trials' run folders are
    device: str = "cpu"  #: that trials compute on; a GPU, if one of them does


class Executor(ABC):
    """Runs trials. Built with ``(options, work)``."""

    @abstractmethod
    def free(self) -> int:
        """How many more trials could start now."""

    @abstractmethod
    def start(self, trial: Trial) -> None:
        """Begin or continue a trial."""

    @abstractmethod
    def wait(self) -> Report | None:
        """The next report of any started trial, or None if none comes for a while. A trial that reported pauses until the next
        call."""

    @abstractmethod
    def stop(self, key: str) -> None:
        """End the trial that reported last; :meth:`wait` gives its final report."""

    def close(self) -> None:  # noqa: B027 - in-process ones hold nothing
        """Stop what still runs and release resources; trials keep their checkpoints."""
