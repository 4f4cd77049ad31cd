"""Where episodes begin: clusters around the goal, a pile in the middle, a disk in the pan."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import Context, InitialStates, Shape
from understudy_amorphous.scene import AmorphousScene
from understudy_amorphous.tool import orientation


class _Blocks:
    """The scene's blocks, to be put somewhere."""

    def __init__(self, context: Context, who: str) -> None:
        self.scene = context.need_scene(AmorphousScene, who)
        self.device = context.device
        block = torch.as_tensor(self.scene.block, dtype=torch.float32)
        self.block = block.to(context.device)  #: (B, 3)
        self.count = self.scene.options.blocks  #: K
        parked = torch.as_tensor(self.scene.place(self.count), dtype=torch.float32)
        self.parked = parked.view(self.count, -1, 3).to(context.device)  #: (K, B, 3)

    def put(self, centres: Tensor, turns: Tensor) -> Tensor:
        """Particles (N, K, B, 3) of blocks at `centres` (N, K, 3), turned about z by `turns` (N, K)."""
        cosine, sine = turns.cos()[..., None], turns.sin()[..., None]
        x, y, z = self.block.unbind(1)
        return centres.unsqueeze(2) + torch.stack(
            [cosine * x - sine * y, sine * x + cosine * y, z.expand(*turns.shape, -1)], dim=3
        )


def _tool(position: Tensor, yaw: Tensor) -> dict[str, Tensor]:
    """A resting tool's state at `position` (N, 3), facing `yaw` (N,)."""
    nothing = torch.zeros_like(yaw)
    return {
        "tool_position": position,
        "tool_orientation": orientation(torch.stack([nothing, nothing, yaw], dim=1)),
    }
