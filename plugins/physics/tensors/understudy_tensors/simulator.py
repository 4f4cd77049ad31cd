"""A simulator whose whole state is tensors of its own."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

import torch
from torch import Tensor

from understudy.running.environment import Environment
from understudy.running.soundness import rows
from understudy.task import Simulator
from understudy_tensors.captured import Captured

__all__ = ["TensorSimulator"]


class TensorSimulator(Simulator):
    """Keeps fields and parameters, (N, …) by name, in ``_state``, which steps change in place.

    *Limits:* it has no physics of its own. All worlds are stepped, even those whose episode has ended.
    """

    _state: dict[str, Tensor]

    def read(self, name: str) -> Tensor:
        return self._state[name]

    def set_state(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        for name, value in state.items():
            own = self._state[name]
            own.copy_(torch.where(rows(worlds, own), value, own))

    def snapshot(self) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in self._state.items()}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        if worlds is None:
            some = next(iter(self._state.values()))
            worlds = torch.ones(len(some), dtype=torch.bool, device=some.device)
        self.set_state(worlds, snapshot)

    def replayed(self, work: Callable[[Tensor], Any], environment: Environment) -> Captured[Any]:
        return Captured(work, environment)
