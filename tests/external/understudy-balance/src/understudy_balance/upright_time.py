"""How long the trunk has been upright."""

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.task import Context, Memory
from understudy_balance.terms import lean


class UprightTime(Memory):
    """Seconds for which the trunk has leaned by no more than `limit` rad, without a break."""

    reads = ("root_rotation",)
    keeps = {"upright_seconds": ()}

    @dataclass(frozen=True)
    class Options:
        limit: float = 0.3  #: rad, the greatest lean that is upright

    def __init__(self, options: Options, context: Context) -> None:
        self._limit, self._dt = options.limit, context.control_dt

    def begin(self, root_rotation: Tensor) -> dict[str, Tensor]:
        return {"upright_seconds": torch.zeros_like(root_rotation[:, 0])}

    def advance(self, kept: Mapping[str, Tensor], root_rotation: Tensor) -> dict[str, Tensor]:
        longer = kept["upright_seconds"] + self._dt
        return {"upright_seconds": torch.where(lean(root_rotation) <= self._limit, longer, 0.0)}
