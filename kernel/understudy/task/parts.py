"""The parts of a task that turn state into something else: fields, observations, controls, memory,
and where episodes begin.

All but initial states and curricula are pure: what they keep, the environment keeps for them.
Fields come in by keyword, under the names in ``reads``. On an accelerator a step is captured once
and replayed, so tensors that a part uses in a step are changed in place, never replaced, and
nothing in a step waits for the device.
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
    """Derives state fields from others; runs at most once a step, only when a field is needed."""

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
    #: Of an observation (N, D) the names of its D columns; without them they are numbered.
    columns: Sequence[str] = ()

    @abstractmethod
    def encode(self, *args: Any, **fields: Any) -> Tensor:
        """The observation (N, …); called with the fields of ``reads`` by keyword."""


class Actuation(ABC):
    """Turns actions (N, A) into controls (N, U).

    A decision of the policy lasts one or more control periods, a control period several physics
    sub-steps. ``every`` says how often the control is computed anew from the same action.
    """

    reads: tuple[str, ...] = ()
    action_space: ActionSpace
    every: Literal["decision", "period", "substep"] = "decision"
    #: Tensors per world that the environment keeps for it, readable as fields (an integrated tool).
    keeps: Mapping[str, Shape] = {}

    def begin(self, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """What it ``keeps`` at the beginning of an episode, from the fields of ``reads``."""
        return {}

    def advance(self, action: Tensor, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """What it ``keeps`` from here on; called before each :meth:`control`."""
        return {}

    @abstractmethod
    def control(self, action: Tensor, *args: Any, **fields: Any) -> Tensor:
        """(N, U); called with the action (N, A), and the fields of ``reads`` by keyword."""


class Memory(ABC):
    """Tensors per world that carry an episode's past: timers, latches, means, targets drawn anew.
    No replay buffer, and no recurrent state of a network.

    They are fields. After every control period :meth:`advance` is called with the fields as they
    are then, among them its own tensors from before; memories advance in their order.
    """

    reads: tuple[str, ...] = ()
    keeps: Mapping[str, Shape]
    #: How many random numbers in [0, 1) it is handed at every call, as ``uniforms`` (N, this).
    uniforms: int = 0

    @abstractmethod
    def begin(self, *args: Any, **fields: Any) -> Mapping[str, Tensor]:
        """What it ``keeps`` at the beginning of an episode, each (N, …)."""

    @abstractmethod
    def advance(
        self, kept: Mapping[str, Tensor], *args: Any, **fields: Any
    ) -> Mapping[str, Tensor]:
        """What it ``keeps`` one control period later, from what it `kept` (by its own names)."""


class InitialStates(ABC):
    """Where episodes begin; may learn from the rollouts where it is worth beginning."""

    #: Fields of the curriculum (``difficulty`` is always there) that :meth:`sample` takes.
    reads: tuple[str, ...] = ()
    #: Per-episode constants that :meth:`sample` returns beside the simulator's state; readable as
    #: fields, constant until the world's next episode.
    episode_fields: Mapping[str, Shape] = {}
    #: Simulator parameters that :meth:`sample` returns too: those in which worlds then differ.
    varies: tuple[str, ...] = ()
    #: Fields to be kept at every step of a rollout for :meth:`update`.
    rollout_fields: tuple[str, ...] = ()
    #: Control periods that a beginning simulates without control before the episode starts, for
    #: what must come to rest first. Costs that many steps of all worlds whenever one begins.
    settle: int = 0

    @abstractmethod
    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        """One initial state for each of the N worlds: the simulator's ``state_fields``,
        ``episode_fields`` and ``varies``, each (N, …), of which rows of worlds that begin are used."""

    def update(self, rollout: Rollout) -> dict[str, float]:
        """Learn from a digested rollout (its ``returns`` are set); returns metrics."""
        return {}

    def state_dict(self) -> State:
        return {}

    def load_state_dict(self, state: State) -> None:  # noqa: B027
        """Restore what :meth:`state_dict` returned."""


class Curriculum(ABC):
    """Changes what the next episodes begin with as learning goes on.

    What it ``provides`` are per-episode fields that initial states and terms may read. Three names
    mean something to the environment: ``difficulty`` (), in [0, 1]; ``episode_limit`` () s, after
    which an episode is cut; and names of simulator parameters, which are set. In an evaluation
    (``context.evaluating``) it stands at ``context.difficulty`` and is never updated.
    """

    provides: Mapping[str, Shape]
    #: Fields to be kept at every step of a rollout for :meth:`update`.
    rollout_fields: tuple[str, ...] = ()

    @abstractmethod
    def begin(self, streams: WorldStreams) -> dict[str, Tensor]:
        """What it ``provides`` to episodes that begin now, each (N, …)."""

    def decision(self) -> int | None:
        """Control periods of one decision from now on, for all worlds; None leaves the task's."""
        return None

    @abstractmethod
    def update(self, rollout: Rollout) -> dict[str, float]:
        """Learn from a digested rollout; returns metrics, of which ``mark/TEXT`` marks curves."""

    def finished(self) -> bool:
        """Whether learning on is of no use, whatever the budget."""
        return False

    @abstractmethod
    def stage(self) -> str:
        """Where it stands, in a few words for the progress line."""

    @abstractmethod
    def state_dict(self) -> State: ...

    @abstractmethod
    def load_state_dict(self, state: State) -> None: ...
