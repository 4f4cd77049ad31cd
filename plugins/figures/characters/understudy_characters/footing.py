"""How the feet of a character stood on the floor in an episode so far."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Memory, Shape
from understudy_characters.contacts import foot_points
from understudy_characters.scene import CharacterScene

#: m above a foot's lowest point: points that touch the floor with it.
SOLE = 0.015


class Footing(Memory):
    """How the feet stood, from the positions of their corners at the ends of control periods.

    - ``foot_slide`` () m/s: how fast feet that touched the floor moved along it, their mean; 0 while none did. Of a foot's points that
      were and are low the one that moves least counts, so that a foot that rolls or pivots does not slide.
    - ``foot_sink`` () m: the deepest that any foot was in the floor
    - ``foot_contacts`` () how many control periods of a foot the mean is of
    - ``foot_corners`` (F, P, 3) m: where the feet's points were, world frame
    """

    reads = ("xpos", "xmat")

    @dataclass(frozen=True)
    class Options:
        touching: float = 0.01  #: m above the floor, within which a foot still touches it

        def __post_init__(self) -> None:
            check_range(self, "touching", least=0, most=1)

    def __init__(self, options: Options, context: Context) -> None:
        character = context.need_scene(CharacterScene, "memory 'characters/footing'").character
        points = foot_points(character)
        most = max(len(own) for own in points.values())
        # a foot of fewer points has its last one more than once
        filled = [own[torch.arange(most).clamp(max=len(own) - 1)] for own in points.values()]
        self._points = torch.stack(filled).float().to(context.device)
        bodies = {joint.name: joint.body for joint in character.joints}
        self._bodies = torch.tensor([bodies[name] for name in points], device=context.device)
        self._touching, self._dt = options.touching, context.control_dt
        self.keeps: Mapping[str, Shape] = {
            "foot_slide": (), "foot_sink": (), "foot_contacts": (), "foot_corners": (*self._points.shape,),
        }  # fmt: skip

    def begin(self, xpos: Tensor, xmat: Tensor) -> dict[str, Tensor]:
        corners = self._corners(xpos, xmat)
        nothing = torch.zeros_like(corners[:, 0, 0, 0])
        return {
            "foot_slide": nothing,
            "foot_sink": self._depth(corners),
            "foot_contacts": nothing,
            "foot_corners": corners,
        }

    def advance(self, kept: Mapping[str, Tensor], xpos: Tensor, xmat: Tensor) -> dict[str, Tensor]:
        corners, before = self._corners(xpos, xmat), kept["foot_corners"]
        lowest, was_lowest = (points[..., 2].amin(dim=2) for points in (corners, before))
        low = corners[..., 2] <= lowest.unsqueeze(2) + SOLE
        was_low = before[..., 2] <= was_lowest.unsqueeze(2) + SOLE
        both = low & was_low
        stayed = both.any(dim=2, keepdim=True)
        both = torch.where(stayed, both, low)  # where no point of it stayed, it rolls
        moved = torch.linalg.vector_norm(corners[..., :2] - before[..., :2], dim=-1) / self._dt
        speed = torch.where(both, moved, torch.inf).amin(dim=2)
        touches = torch.maximum(lowest, was_lowest) <= self._touching
        count = kept["foot_contacts"] + touches.sum(dim=1)
        more = torch.where(touches, speed - kept["foot_slide"].unsqueeze(1), 0.0).sum(dim=1)
        return {
            "foot_slide": kept["foot_slide"] + more / count.clamp(min=1),
            "foot_sink": torch.maximum(kept["foot_sink"], self._depth(corners)),
            "foot_contacts": count,
            "foot_corners": corners,
        }

    def _corners(self, xpos: Tensor, xmat: Tensor) -> Tensor:
        """(N, F, P, 3) m, world frame."""
        at = xpos.index_select(1, self._bodies).unsqueeze(2)
        turned = xmat.index_select(1, self._bodies).reshape(len(xpos), -1, 1, 3, 3)
        return at + (turned @ self._points.unsqueeze(-1)).squeeze(-1)

    def _depth(self, corners: Tensor) -> Tensor:
        """(N,) m, how deep the lowest of all corners is in the floor; 0 above it."""
        return (-corners[..., 2].amin(dim=(1, 2))).clamp(min=0.0)
