"""The parts of a task that turn state into something else: fields, observations, controls, memory,
and where episodes begin.

All but initial states and curricula are pure functions: the environment keeps their state for
them. Fields are passed by keyword, under the names in ``reads``. On an accelerator a step is
captured once and replayed, so tensors that a part uses in a step are changed in place, never
replaced, and nothing in a step waits for the device.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any, Literal

from understudy.task.actions import ActionSpace
from understudy.task.base import Shape, State

if TYPE_CHECKING:
    from torch import Tensor

    from understudy.random import WorldStreams
    from understudy.task.rollout import Rollout


class Fields(ABC):
    """Derives state fields from others; runs at most once per step, only if a field is needed."""

    #: The fields that :meth:`compute` takes, by keyword.
    reads: tuple[str, ...]
    #: The fields it returns and their shapes without N.
    provides: Mapping[str, Shape]

    @abstractmethod
    def compute(self, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """All provided fields, each (N, …). A pure function of its arguments."""


class Encoder(ABC):
    """Turns state fields into one observation (N, …). A pure function; networks are the policy's."""

    reads: tuple[str, ...]
    #: Shape of the observation without N.
    shape: Shape
    #: The names of the D columns of an observation (N, D); without names they are numbered.
    columns: Sequence[str] = ()

    @abstractmethod
    def encode(self, *args: Any, **fields: Any) -> Tensor:
        """The observation (N, …); called with the fields of ``reads`` by keyword."""


class Actuation(ABC):
    """Turns actions (N, A) into controls (N, U).

    A decision of the policy lasts one or more control periods, each of several physics sub-steps.
    ``every`` says how often a new control is computed from the same action.
    """

    reads: tuple[str, ...] = ()
    action_space: ActionSpace
    every: Literal["decision", "period", "substep"] = "decision"
    #: Tensors per world that the environment keeps for it, as fields (an integrated target, say).
    keeps: Mapping[str, Shape] = {}

    def begin(self, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """What it ``keeps`` at the beginning of an episode; called with the fields of ``reads``."""
        return {}

    def advance(self, action: Tensor, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """What it ``keeps`` from here on; called before each :meth:`control`."""
        return {}

    @abstractmethod
    def control(self, action: Tensor, *args: Any, **fields: Any) -> Tensor:
        """(N, U); called with the action (N, A), and the fields of ``reads`` by keyword."""


class Memory(ABC):
    """Tensors per world that carry an episode's past, such as timers, latches, means and targets.
    Not a replay buffer, and not the recurrent state of a network.

    They are fields. After every control period, :meth:`advance` is called with the present fields
    and its own tensors from before; memories advance in the order of the configuration.
    """

    reads: tuple[str, ...] = ()
    keeps: Mapping[str, Shape]
    #: How many random numbers in [0, 1) it is given in every call, as ``uniforms`` (N, this).
    uniforms: int = 0

    @abstractmethod
    def begin(self, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """What it ``keeps`` at the beginning of an episode, each (N, …)."""

    @abstractmethod
    def advance(
        self, kept: Mapping[str, Tensor], *args: Any, **fields: Any
    ) -> Mapping[str, Tensor]:
        """What it ``keeps`` one control period later, from what it `kept`, by its own names."""


class InitialStates(ABC):
    """Where episodes begin; may learn from rollouts where it is worth beginning."""

    #: Fields of the curriculum that :meth:`sample` takes; ``difficulty`` is always there.
    reads: tuple[str, ...] = ()
    #: Fields that :meth:`sample` returns beside the simulator's state, constant in an episode.
    episode_fields: Mapping[str, Shape] = {}
    #: Simulator parameters that :meth:`sample` returns, too, and in which worlds then differ.
    varies: tuple[str, ...] = ()
    #: Fields to be kept at every step of a rollout for :meth:`update`.
    rollout_fields: tuple[str, ...] = ()
    #: Control periods simulated without control before an episode starts, for what must first come
    #: to rest. It costs that many steps of all worlds whenever one begins.
    settle: int = 0

    @abstractmethod
    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        """One initial state for each of the N worlds: the simulator's ``state_fields``,
        ``episode_fields`` and ``varies``, each (N, …). Only rows of worlds that begin count."""

    def update(self, rollout: Rollout) -> dict[str, float]:
        """Learn from a digested rollout (its ``returns`` are set); returns metrics."""
        return {}

    def state_dict(self) -> State:
        return {}

    def load_state_dict(self, state: State) -> None:  # noqa: B027
        """Restore what :meth:`state_dict` returned."""


class Curriculum(ABC):
    """Changes what the next episodes begin with as learning goes on.

    It ``provides`` fields, constant in an episode, that initial states and terms may read. Three
    kinds of names mean something to the environment: ``difficulty`` (), in [0, 1];
    ``episode_limit`` () s, at which an episode is truncated; and simulator parameters, which are
    set. In an evaluation (``context.evaluating``) it is at ``context.difficulty`` and not updated.
    """

    provides: Mapping[str, Shape]
    #: Fields to be kept at every step of a rollout for :meth:`update`.
    rollout_fields: tuple[str, ...] = ()

    @abstractmethod
    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        """What it ``provides`` to episodes that begin now, each (N, …)."""

    def decision(self) -> int | None:
        """Control periods in a decision from now on, in all worlds; None leaves the task's own."""
        return None

    @abstractmethod
    def update(self, rollout: Rollout) -> dict[str, float]:
        """Learn from a digested rollout; returns metrics. ``mark/TEXT`` marks curves with TEXT."""

    def finished(self) -> bool:
        """Whether there is no use in learning on, whatever the budget."""
        return False

    @abstractmethod
    def stage(self) -> str:
        """How far it is, in a few words for the progress line."""

    @abstractmethod
    def state_dict(self) -> State: ...

    @abstractmethod
    def load_state_dict(self, state: State) -> None: ...
