"""What simulators of particles in Warp have in common: a state of torch views, and kernels that advance it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
from torch import Tensor

from understudy.running.environment import Environment
from understudy.task import Context, Simulator
from understudy_tensors.captured import Captured
from understudy_warp_torch.kernels import Kernels
from understudy_warp_torch.world_state import WorldState

__all__ = ["WarpSimulator"]


class WarpSimulator(Simulator):
    """N worlds in Warp's arrays. A subclass fills `_worlds`, `_control` and `_counted` as it is made, and
    advances the worlds."""

    _worlds: WorldState
    #: (N, control_size) what the kernels read it from
    _control: Tensor
    #: what the report calls it, and (K,) what the kernels count since the beginning
    _counted: tuple[str, Tensor]

    def __init__(self, context: Context) -> None:
        self._warp = Kernels(context.device)
        self._device: torch.device = self._warp.device
        self._n = context.num_worlds
        #: of a control period, and how long one is, s
        self._substeps, self._dt = context.substeps, context.control_dt / context.substeps

    @abstractmethod
    def _advance(self, count: int) -> None:
        """Launch the kernels of `count` sub-steps."""

    def vary(self, names: Sequence[str]) -> None:
        self.fields = {**self.fields, **self._worlds.vary(names)}

    def read(self, name: str) -> Tensor:
        return self._worlds.views[name]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        self._worlds.set(worlds, state)

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        count = self._substeps if substeps is None else substeps
        self._worlds.begin_step()
        self._control.copy_(control)
        changed = (*self._worlds.state.values(), self._counted[1])
        self._warp.run(count, lambda: self._advance(count), changed)

    def replayed(self, work: Callable[[Tensor], Any], environment: Environment) -> Captured[Any]:
        return Captured(work, environment)

    def failed(self) -> Tensor:
        return self._worlds.failed()

    def snapshot(self) -> dict[str, Tensor]:
        return self._worlds.snapshot()

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        self._worlds.restore(snapshot, worlds)

    def report(self) -> dict[str, int]:
        name, counter = self._counted
        count = int(counter.sum())
        return {name: count} if count else {}
