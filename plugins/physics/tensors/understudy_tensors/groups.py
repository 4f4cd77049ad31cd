"""Worlds of one job divided into groups, each with settings of its own: candidates side by side."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context, Shape

__all__ = ["Groups"]


class Groups:
    """World i belongs to group i mod G, so the sizes of groups differ by one world at most.

    Parameters
    ----------
    names
        of the G groups. If there are several, each is a field ``from_NAME`` (), 1 in the worlds of that group.
    context
        of the task; an evaluation may have fewer worlds than groups.
    absent
        names without any world, whose fields are 0 everywhere.

    Raises
    ------
    ConfigError
        a training has fewer worlds than groups.
    """

    def __init__(self, names: Sequence[str], context: Context, absent: Sequence[str] = ()) -> None:
        num_worlds, device = context.num_worlds, context.device
        if len(names) > num_worlds and not context.evaluating:
            raise ConfigError(
                f"{len(names)} groups are more than there are worlds ({num_worlds}). Raise num_worlds."
            )
        self.names = tuple(names)
        #: (N,) int64: the group of each world.
        self.number = torch.arange(num_worlds, device=device) % len(names)
        self._flags = {
            f"from_{name}": (self.number == row).float() for row, name in enumerate(names)
        } | {f"from_{name}": torch.zeros(num_worlds, device=device) for name in absent}

    @property
    def fields(self) -> dict[str, Shape]:
        """Names and shapes of :meth:`flags`."""
        return dict.fromkeys(self._flags, ())

    def flags(self) -> dict[str, Tensor]:
        """``from_NAME`` (N,) of each group."""
        return dict(self._flags)

    def of_worlds(self, rows: Any) -> Tensor:
        """(N, …) float32: for each world, the row of its group in `rows` (G, …)."""
        found = torch.as_tensor(rows, dtype=torch.float32).to(self.number.device)
        return found[self.number]

    def sums(self, values: Tensor) -> Tensor:
        """(…, G) of `values` (…, N): over the worlds of each group."""
        zeros = values.new_zeros((*values.shape[:-1], len(self.names)))
        return zeros.index_add_(-1, self.number, values)
