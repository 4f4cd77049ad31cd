"""What is simulated, and what simulates it."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import TYPE_CHECKING, Any, TypeVar

from understudy.errors import ConfigError, UnderstudyError, suggestion
from understudy.task.base import Shape

if TYPE_CHECKING:
    import numpy as np
    from torch import Tensor

    from understudy.running.environment import Environment

T = TypeVar("T")


class Scene(ABC):
    """What is simulated. Each family of simulators defines the scene type it accepts."""

    #: Fields of one world to record for :meth:`draw` and :meth:`outlines`, if the task has them.
    recorded: tuple[str, ...] = ()
    azimuth: float | None = None  #: where :meth:`draw` looks, degrees from x; None is its choice
    members: Mapping[str, Scene] = {}  #: by name, the scenes that it consists of

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Facts for provenance: sizes, masses, names."""

    def identity(self) -> Mapping[str, str]:
        """By state field: whose state it is, in words that differ between things, so that the state
        of another garment or body is not taken for one of this."""
        return {}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 640, height: int = 360
    ) -> Iterator[np.ndarray]:
        """Frames (height, width, 3) uint8 of the recorded `tracks`, each (T, …); an UnderstudyError
        if drawing is not possible here (no OpenGL)."""
        raise UnderstudyError(f"scene {type(self).__name__} cannot be drawn.")

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        """Stick figures of the recorded motion and of its reference, each (T, S, 2, 3) line
        segments in metres (world frame, z up), or None."""
        return None, None


class Simulator(ABC):
    """Owns the physics state of N worlds and advances all of them at once.

    On a GPU :meth:`read`, :meth:`set_state`, :meth:`step` and :meth:`restore` may be captured in a
    CUDA graph of the caller's, once each was called before in the same way.
    """

    #: Readable fields and their shapes without N.
    fields: Mapping[str, Shape] = {}
    #: Fields that :meth:`set_state` needs to define a state.
    state_fields: tuple[str, ...]
    #: U, the number of controls.
    control_size: int
    #: Parameters in which worlds may differ once :meth:`vary` has named them, and their shapes.
    parameters: Mapping[str, Shape] = {}

    def vary(self, names: Sequence[str]) -> None:
        """Let worlds differ in these ``parameters``; called once, before the first state is set.
        They become fields of the same names, and begin with the model's values. A ConfigError for a
        parameter that the simulator does not know."""
        for name in names:
            known = suggestion(name, self.parameters)
            raise ConfigError(f"There is no parameter '{name}' in which worlds may differ.{known}")

    @abstractmethod
    def read(self, name: str) -> Tensor:
        """The field `name`, (N, …), at the present state and control; valid until the next call
        that changes the state. It may be the simulator's own memory, so do not write to it."""

    @abstractmethod
    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        """Put the worlds where `worlds` (N,) bool is true into `state`, at time 0.

        `state` has the ``state_fields``, and may have controls, which are otherwise 0, and varied
        parameters, each (N, …). Parameters that it leaves out keep their values.
        """

    @abstractmethod
    def step(self, control: Tensor, substeps: int | None = None) -> None:
        """Advance by one control period, or by `substeps` physics steps, under `control` (N, U)."""

    @abstractmethod
    def failed(self) -> Tensor:
        """(N,) bool: worlds that went wrong (not finite, diverged, reset by the engine) since their
        state was set, or since this was last called. It is called after every step."""

    @abstractmethod
    def snapshot(self) -> dict[str, Tensor]:
        """An exact copy of all that the future depends on, varied parameters too, each (N, …)."""

    @abstractmethod
    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        """Continue exactly from a :meth:`snapshot` of as many worlds; if `worlds` (N,) bool is
        given, only in those where it is true."""

    def replayed(
        self, work: Callable[[Tensor], T], environment: Environment
    ) -> Callable[[Tensor], T]:
        """A function to call instead of `work`, which steps `environment` by an action (N, A). On
        an accelerator it may capture `work` once and replay it; a call then overwrites what the
        last one returned."""
        return work

    def report(self) -> dict[str, int]:
        """By name: how often something went wrong since the start (engine warnings, overflows)."""
        return {}

    def close(self) -> None:  # noqa: B027 - most simulators hold nothing
        """Release resources."""
