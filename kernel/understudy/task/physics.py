"""What is simulated, and by what."""

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

    #: Fields of one world that :meth:`draw` and :meth:`outlines` want recorded, where the task has them.
    recorded: tuple[str, ...] = ()
    azimuth: float | None = None  #: where :meth:`draw` looks, degrees from x; None is its own
    members: Mapping[str, Scene] = {}  #: by name, the scenes that it consists of

    @abstractmethod
    def describe(self) -> dict[str, Any]:
        """Facts for provenance: sizes, masses, names."""

    def identity(self) -> Mapping[str, str]:
        """By state field, the thing whose state it is, in words that differ between things: the
        state of another garment or body is not to be taken for one of this."""
        return {}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 640, height: int = 360
    ) -> Iterator[np.ndarray]:
        """Frames (height, width, 3) uint8 of the recorded `tracks`, each (T, …); an UnderstudyError if
        nothing can be drawn here (no OpenGL)."""
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
        """The field `name`, (N, …), at the present state and under the present control; valid until
        the next call that changes the state. May be the simulator's own memory: not to be written."""

    @abstractmethod
    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        """Put the worlds where `worlds` (N,) bool is true into `state` at rest time.

        `state` has the ``state_fields`` and may have controls, which are 0 else, and varied
        parameters, each (N, …). Parameters that it leaves out keep their values.
        """

    @abstractmethod
    def step(self, control: Tensor, substeps: int | None = None) -> None:
        """Advance all worlds by a control period, or `substeps` of it, under `control` (N, U)."""

    @abstractmethod
    def failed(self) -> Tensor:
        """(N,) bool: worlds that went wrong (non-finite, diverged, reset by the engine) since their
        state was set, or in the steps since this was last asked. It is asked after every step."""

    @abstractmethod
    def snapshot(self) -> dict[str, Tensor]:
        """An exact copy of all that decides the future, varied parameters too, each (N, …)."""

    @abstractmethod
    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        """Continue exactly from a :meth:`snapshot` of as many worlds; only those where `worlds`
        (N,) bool is true, if given."""

    def replayed(
        self, work: Callable[[Tensor], T], environment: Environment
    ) -> Callable[[Tensor], T]:
        """`work` on an action (N, A), which steps `environment`, as it is called from now on: an
        accelerator may take it down once and replay it, and the next call overwrite what it returns."""
        return work

    def report(self) -> dict[str, int]:
        """Counts of what went wrong since the start (engine warnings, overflows), by name."""
        return {}

    def close(self) -> None:  # noqa: B027 - most simulators hold nothing
        """Release what the simulator holds."""
