"""The interfaces of the kernel: what a plugin may provide, and what it is handed.

Shapes: N worlds, T steps, D observation size, A action size, U control size. All tensors of a task
live on one device; float32 unless said otherwise. Interfaces are abstract, implementations final:
to change a part, wrap or replace it.

A component's class takes ``(options, context)``: an instance of its nested ``Options`` dataclass and
the :class:`Context` of what is being built. Reward and termination terms are plain functions: their
positional parameters name the state fields they read, their keyword-only parameters are options.
"""

from __future__ import annotations

import argparse
from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any, TypeVar

import numpy as np
import torch
from torch import Tensor, nn

from understudy.errors import ConfigError, UnderstudyError

if TYPE_CHECKING:
    from understudy.random import WorldStreams
    from understudy.records.runs import Run

State = Mapping[str, Any]
"""What ``state_dict`` returns: nested mappings of tensors, numbers, strings and lists thereof."""

Shape = tuple[int, ...]
"""A field's shape without its leading N: () for one number a world, (3,) for a vector."""

T = TypeVar("T")


@dataclass
class Context:
    """What a component can know of the task it is built for.

    Filled in the order of building: sections, scene, simulator, then everything else. ``action_size``
    and ``observation_shapes`` are known when policy and learner are built.
    """

    seed: int
    device: torch.device
    num_worlds: int
    control_dt: float
    substeps: int
    sections: Mapping[str, Any] = field(default_factory=dict)
    scene: Scene | None = None
    simulator: Simulator | None = None
    action_size: int = 0
    observation_shapes: Mapping[str, Shape] = field(default_factory=dict)

    _shared: dict[str, Any] = field(default_factory=dict, repr=False)

    def once(self, key: str, build: Callable[[], T]) -> T:
        """The object `key` that several parts share, built by whoever asks first."""
        if key not in self._shared:
            self._shared[key] = build()
        return self._shared[key]

    def need_scene(self, kind: type[T], who: str) -> T:
        """The scene, which must be a `kind`; else an error naming `who` needs it."""
        if not isinstance(self.scene, kind):
            have = type(self.scene).__name__ if self.scene is not None else "no scene"
            raise ConfigError(
                f"{who} needs a scene of type {kind.__name__}, but the task has {have}. "
                "Choose a scene and a simulator that belong together (scene=…, simulator=…)."
            )
        return self.scene

    def need_section(self, name: str, kind: type[T], who: str) -> T:
        """The object built from the config section `name`; else an error naming `who` needs it."""
        value = self.sections.get(name)
        if not isinstance(value, kind):
            raise ConfigError(
                f"{who} needs the config section '{name}', which this task does not set. "
                f"Add it (for example {name}.name=…) or choose another part."
            )
        return value


class Command(ABC):
    """A command of the command line, registered as a ``command`` named by its words: the component
    ``motion check`` is run as ``understudy motion check``. Its summary is its help."""

    @abstractmethod
    def arguments(self, parser: argparse.ArgumentParser) -> None:
        """Add the command's arguments."""

    @abstractmethod
    def run(self, options: argparse.Namespace) -> int:
        """Carry it out; returns the exit status. What the user can cause is raised as an
        :class:`UnderstudyError`."""


class Scene(ABC):
    """What is simulated. Each family of simulators defines the scene type it accepts."""

    #: Fields of one world that :meth:`draw` and :meth:`outlines` want recorded, where the task has them.
    recorded: tuple[str, ...] = ()

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Facts for provenance: sizes, masses, names."""

    def draw(self, tracks: Mapping[str, np.ndarray]) -> Iterator[np.ndarray]:
        """Frames (H, W, 3) uint8 of the recorded `tracks`, each (T, …).

        Raises
        ------
        UnderstudyError
            if nothing can be drawn here (no OpenGL).
        """
        raise UnderstudyError(f"scene {type(self).__name__} cannot be drawn.")

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Stick figures of the recorded motion and of its reference, each (T, S, 2, 3) line
        segments in metres (world frame, z up), or None."""
        return None, None


class Simulator(ABC):
    """Owns the physics state of N worlds and advances all of them at once.

    On a GPU :meth:`read`, :meth:`set_state`, :meth:`step` and :meth:`restore` may be recorded in a
    CUDA graph of the caller's, once each was called before in the same way.
    """

    #: Readable fields and their shapes without N.
    fields: Mapping[str, Shape] = {}
    #: Fields that :meth:`set_state` needs to define a state.
    state_fields: tuple[str, ...]
    #: U, the number of controls.
    control_size: int
    #: Parameters of the model that may differ between worlds, and their shapes without N.
    parameters: Mapping[str, Shape] = {}

    @abstractmethod
    def vary(self, names: Sequence[str]) -> None:
        """Let worlds differ in these parameters; called once, before the first state is set.

        They become fields of the same names, and begin with the model's values.

        Raises
        ------
        ConfigError
            for a name that is not one of ``parameters``.
        """

    @abstractmethod
    def read(self, name: str) -> Tensor:
        """The field `name`, (N, …), at the present state and under the present control; valid until
        the next call that changes the state. May be the simulator's own memory: not to be written."""

    @abstractmethod
    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        """Put the worlds where `worlds` (N,) bool is true into `state` at rest time, all controls 0.

        `state` has the ``state_fields`` and may have varied parameters, each (N, …). Parameters that
        it leaves out keep their values. Everything that derives from the two follows.
        """

    @abstractmethod
    def step(self, control: Tensor, substeps: int | None = None) -> None:
        """Advance every world under `control` (N, U) by `substeps` physics steps; None takes those
        of a whole control period."""

    @abstractmethod
    def failed(self) -> Tensor:
        """(N,) bool: worlds whose last step went wrong (non-finite, diverged, reset by the engine)."""

    @abstractmethod
    def snapshot(self) -> dict[str, Tensor]:
        """A copy of everything that decides the future, varied parameters too, each (N, …), in full
        precision."""

    @abstractmethod
    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        """Continue exactly from a :meth:`snapshot` of as many worlds; only those where `worlds` (N,)
        bool is true, if it is given."""

    def report(self) -> dict[str, int]:
        """Counts of what went wrong since the start (engine warnings, overflows), by name."""
        return {}

    def close(self) -> None:  # noqa: B027 - most simulators hold nothing
        """Release what the simulator holds."""


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
    """Turns state fields into one observation tensor (N, …). A pure function."""

    reads: tuple[str, ...]
    #: Shape of the observation without N.
    shape: Shape

    @abstractmethod
    def encode(self, *args: Any, **fields: Any) -> Tensor:
        """The observation (N, …); called with the fields of ``reads`` by keyword."""


class Actuation(ABC):
    """Turns actions (N, A) into controls (N, U). A pure function."""

    reads: tuple[str, ...] = ()
    #: A.
    action_size: int

    @abstractmethod
    def control(self, *args: Any, **fields: Any) -> Tensor:
        """(N, U); called with the action (N, A), and the fields of ``reads`` by keyword."""


class InitialStates(ABC):
    """Where episodes begin; may learn from the rollouts where it is worth beginning."""

    #: Per-episode constants that :meth:`sample` returns beside the simulator's state; readable as
    #: fields, constant until the world's next episode.
    episode_fields: Mapping[str, Shape] = {}
    #: Fields to be recorded at every step of a rollout for :meth:`update`.
    records: tuple[str, ...] = ()

    @abstractmethod
    def sample(self, streams: WorldStreams) -> dict[str, Tensor]:
        """One initial state for each of the N worlds: the simulator's ``state_fields`` and
        ``episode_fields``, each (N, …). The environment uses the rows of worlds that begin."""

    def update(self, rollout: Rollout) -> dict[str, float]:
        """Learn from a digested rollout (its ``returns`` are set); returns metrics."""
        return {}

    def state_dict(self) -> State:
        return {}

    def load_state_dict(self, state: State) -> None:  # noqa: B027
        """Restore what :meth:`state_dict` returned."""


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


class Policy(nn.Module):
    """Observation to action distribution and value; owns no environment.

    Subclasses implement :meth:`distribution` and :meth:`value` and keep actor and critic apart
    (:meth:`actor_parameters`, :meth:`critic_parameters`) so that learners can give them rates.
    """

    def distribution(self, observations: Mapping[str, Tensor]) -> Distribution:
        """For observations (…, D) by name."""
        raise NotImplementedError

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        """(…,) expected discounted return."""
        raise NotImplementedError

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        raise NotImplementedError

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        raise NotImplementedError

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        """Update running statistics from a rollout's observations (T, N, D)."""

    def schedule(self, samples: int) -> None:
        """Set what follows a schedule (exploration noise) for `samples` consumed so far."""


@dataclass
class Rollout:
    """T steps of N worlds, time first. ``values`` and ``returns`` are the learner's to fill."""

    observations: dict[str, Tensor]  #: each (T, N, …), before the action
    last_observations: dict[str, Tensor]  #: each (N, …), after the last step
    actions: Tensor  #: (T, N, A)
    log_probs: Tensor  #: (T, N)
    rewards: Tensor  #: (T, N)
    terminated: Tensor  #: (T, N) bool: the episode ended here and nothing follows
    truncated: Tensor  #: (T, N) bool: the episode was cut here; ``final_values`` continues it
    final_values: Tensor  #: (T, N) value of the state after a truncated step, 0 elsewhere
    records: dict[str, Tensor]  #: fields the initial states asked for, before the action, (T, N, …)
    values: Tensor | None = None  #: (T, N)
    returns: Tensor | None = None  #: (T, N)


class Learner(ABC):
    """Improves a policy from rollouts."""

    #: T, the steps per world and iteration.
    rollout_steps: int
    #: Called once with what led to the first non-finite step, so that it can be replayed.
    on_fault: Callable[[Mapping[str, Tensor]], None] | None = None

    @abstractmethod
    def update(self, rollout: Rollout) -> dict[str, float]:
        """One improvement; sets the rollout's ``values`` and ``returns``; returns metrics.

        A step whose loss or gradient is not finite must leave the weights as they were and count
        in the metric ``skipped_steps``.
        """

    @abstractmethod
    def state_dict(self) -> State: ...

    @abstractmethod
    def load_state_dict(self, state: State) -> None: ...


@dataclass(frozen=True)
class Trial:
    """One training that an outer loop asks for."""

    key: str
    overrides: tuple[str, ...]


@dataclass(frozen=True)
class Result:
    """What came back of a trial. ``status`` is ``ok`` or why there is no objective."""

    key: str
    status: str
    objective: float | None = None
    features: Mapping[str, float] = field(default_factory=dict)
    cost: float = 0.0
    run: str = ""


class OuterLoop(ABC):
    """Proposes trials and digests results. State is whatever was told: replay it to resume."""

    @abstractmethod
    def ask(self) -> Trial | None:
        """The next trial, or None when nothing is left to ask for."""

    @abstractmethod
    def tell(self, result: Result) -> None: ...

    @abstractmethod
    def summary(self) -> list[dict[str, Any]]:
        """Rows of a table of what was found so far."""


class Executor(ABC):
    """Runs trials. ``run`` yields results in the order in which they finish."""

    @abstractmethod
    def run(
        self, trials: Sequence[Trial], train: Callable[[Trial], Result]
    ) -> Iterator[Result]: ...


class RunObserver:
    """Watches a training; every method may be left out. Observers draw no random numbers."""

    def started(self, run: Run) -> None: ...

    def iteration(self, run: Run, row: Mapping[str, float]) -> None: ...

    def finished(self, run: Run, outcome: str) -> None: ...
