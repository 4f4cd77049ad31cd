"""The state of worlds that Warp simulates, as torch sees it: set, kept, restored and judged world by world."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import torch
from torch import Tensor

from understudy.errors import ConfigError, suggestion
from understudy_warp_torch.kernels import put_rows

__all__ = ["WorldState"]


class WorldState:
    """Views of a simulator's own memory, each (N, …), by name.

    What decides the future is in `state`, of which `set_by` is what is given to begin an episode; the rest
    begins as in `initial` (1, …). `parameters` are what worlds may differ in, once :meth:`vary` says so. A
    world is sound while all of `set_by` is finite, positions less than `extent` and velocities (names that
    end so) less than `speed`.
    """

    def __init__(
        self,
        simulator: str,
        *,
        views: Mapping[str, Tensor],
        state: Mapping[str, Tensor],
        initial: Mapping[str, Tensor],
        set_by: Sequence[str],
        parameters: Mapping[str, Tensor],
        extent: float,
        speed: float,
    ) -> None:
        """`views` are the fields that can be read; `simulator` is its name, for messages."""
        self.views = dict(views)
        self.state = state
        self._simulator, self._initial, self._set_by = simulator, initial, tuple(set_by)
        self.parameters = parameters
        self._extent, self._speed = extent, speed
        self._varied: tuple[str, ...] = ()
        first = next(iter(state.values()))
        #: (N,) worlds that began a step with numbers that the step may hide: it moves tools anew.
        self._bad = torch.zeros(len(first), dtype=torch.bool, device=first.device)
        self._asked = False  #: whether anybody was told of those

    def vary(self, names: Sequence[str]) -> Mapping[str, tuple[int, ...]]:
        """Let worlds differ in parameters; their shapes, by name, since they can be read now.

        Raises
        ------
        ConfigError
            for a name that is no parameter.
        """
        for name in names:
            if name not in self.parameters:
                known = suggestion(name, self.parameters)
                raise ConfigError(
                    f"simulator '{self._simulator}' has no parameter '{name}' in which worlds may "
                    f"differ.{known}"
                )
        self._varied = tuple(names)
        self.views.update({name: self.parameters[name] for name in names})
        return {name: tuple(self.parameters[name].shape[1:]) for name in names}

    def set(self, worlds: Tensor, state: Mapping[str, Tensor]) -> None:
        """Begin `worlds` (N,) bool in `state`, whose rows (N, …) are those of all worlds."""
        self._bad &= ~worlds
        self._put_varied(worlds, state)
        for name, view in self.state.items():
            put_rows(view, worlds, state[name] if name in self._set_by else self._initial[name])

    def begin_step(self) -> None:
        """Note who is unsound before a step; who was told of is so no longer."""
        if self._asked:
            self._bad.zero_()
            self._asked = False
        self._bad |= ~self._sound()

    def failed(self) -> Tensor:
        """(N,) bool: unsound now, or before a step since this was last asked."""
        self._asked = True
        return self._bad | ~self._sound()

    def _sound(self) -> Tensor:
        sound = torch.ones_like(self._bad)
        for name in self._set_by:
            limit = self._speed if name.endswith("velocity") else self._extent
            sound &= (self.state[name].abs() < limit).flatten(1).all(dim=1)  # false for NaN
        return sound

    def snapshot(self) -> dict[str, Tensor]:
        """A copy of all that decides the future, varied parameters included."""
        varied = {name: self.parameters[name] for name in self._varied}
        return {name: view.clone() for name, view in {**self.state, **varied}.items()}

    def restore(self, snapshot: Mapping[str, Tensor], worlds: Tensor | None = None) -> None:
        """Go back to `snapshot` in `worlds` (N,) bool, or in all."""
        if worlds is None:
            worlds = torch.ones_like(self._bad)
        self._bad &= ~worlds
        self._put_varied(worlds, snapshot)
        for name, view in self.state.items():
            put_rows(view, worlds, snapshot[name])

    def _put_varied(self, worlds: Tensor, values: Mapping[str, Tensor]) -> None:
        for name in self._varied:
            if name in values:
                put_rows(self.parameters[name], worlds, values[name])
