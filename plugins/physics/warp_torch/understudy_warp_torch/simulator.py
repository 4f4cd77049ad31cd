"""What simulators of particles in Warp have in common: a state of torch views, and kernels that advance it."""

from __future__ import annotations

from abc import abstractmethod
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import torch
import warp as wp
from torch import Tensor

from understudy.running.environment import Environment
from understudy.task import Context, Simulator
from understudy_tensors.captured import Captured
from understudy_warp_torch.compliance import Compliance, Loads
from understudy_warp_torch.kernels import Kernels
from understudy_warp_torch.world_state import WorldState

__all__ = ["WarpSimulator"]


class WarpSimulator(Simulator):
    """N worlds in Warp's arrays. A subclass fills `_worlds`, `_control` and `_counted` as it is made, and `_compliance` and
    `_tools` if it has any, and advances the worlds."""

    _worlds: WorldState
    #: (N, control_size) what the kernels read it from
    _control: Tensor
    #: what the report calls it, and (K,) what the kernels count since the beginning
    _counted: tuple[str, Tensor]
    #: of what its sub-steps may be too long for, if anything
    _compliance: Compliance | None = None
    #: Warp's; without any none moves
    _tools: Any = None
    _loads: Loads | None = None  #: from the first state on

    def __init__(self, context: Context) -> None:
        self._warp = Kernels(context.device)
        self._device: torch.device = self._warp.device
        self._n = context.num_worlds
        #: of a control period, and how long one is, s
        self._substeps, self._dt = context.substeps, context.control_dt / context.substeps

    @abstractmethod
    def _advance(self, count: int) -> None:
        """Launch the kernels of `count` sub-steps."""

    def _carrying(self) -> Tensor:
        """(N, T) bool: which tools carried something in the last sub-steps."""
        return torch.zeros(self._n, int(self._tools.tools), dtype=torch.bool, device=self._device)

    def vary(self, names: Sequence[str]) -> None:
        self.fields = {**self.fields, **self._worlds.vary(names)}

    def read(self, name: str) -> Tensor:
        return self._worlds.views[name]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        self._worlds.set(worlds, state)
        if self._loads is None and self._compliance is not None:
            self._loads = self._first_loads(self._compliance)
        if self._loads is not None:
            self._loads.forget(worlds)

    def _first_loads(self, compliance: Compliance) -> Loads | None:
        """What counts loads that change, if any does; a ConfigError for a first gravity that sub-steps cannot bear."""
        varied = self._worlds.views.get("gravity")
        if varied is not None:
            strongest = float(varied.norm(dim=1).max())
            more = f" The strongest gravity of these worlds is {strongest:.3g} m/s²."
            compliance.check(strongest, self._dt, more)
        tools = int(self._tools.tools)
        if varied is None and not tools:
            return None
        velocity = torch.zeros(self._n, 0, 3, device=self._device)
        if tools:  # torch makes no view of an array without elements on a GPU
            velocity = wp.to_torch(self._tools.velocity)
        return Loads(compliance, self._dt, self._worlds.parameters["gravity"], velocity)

    def step(self, control: Tensor, substeps: int | None = None) -> None:
        count = self._substeps if substeps is None else substeps
        self._worlds.begin_step()
        self._control.copy_(control)
        changed = (*self._worlds.state.values(), self._counted[1])
        self._warp.run(count, lambda: self._advance(count), changed)
        if self._loads is not None:
            self._loads.add(count, self._carrying())

    def replayed(self, work: Callable[[Tensor], Any], environment: Environment) -> Captured[Any]:
        return Captured(work, environment)

    def failed(self) -> Tensor:
        return self._worlds.failed()

    def snapshot(self) -> dict[str, Tensor]:
        return self._worlds.snapshot()

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        self._worlds.restore(snapshot, worlds)

    def report(self) -> dict[str, int]:
        counts = dict([self._counted])
        if self._loads is not None:
            counts["sub_steps_too_long"] = self._loads.count
        found = {name: int(counter.sum()) for name, counter in counts.items()}
        return {name: count for name, count in found.items() if count}
