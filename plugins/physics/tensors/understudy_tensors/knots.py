"""Functions of a number that are linear between points, in all worlds at once."""

from __future__ import annotations

from collections.abc import Sequence

import torch
from torch import Tensor

__all__ = ["Knots"]


class Knots:
    """K points (place, value) with rising places: linear in between, constant beyond the first and the last."""

    def __init__(
        self,
        points: Sequence[tuple[float, float]],
        device: torch.device,
        dtype: torch.dtype = torch.float32,
    ) -> None:
        self._places, self._values = torch.tensor(points, device=device, dtype=dtype).T.contiguous()
        self._steps = self._places.diff().clamp(min=1e-9)

    def at(self, place: Tensor) -> Tensor:
        """The values at `place` (N,): (N,), or () if there is one point."""
        last = len(self._places) - 1
        if last == 0:
            return self._values[0]
        left = (torch.searchsorted(self._places, place.contiguous()) - 1).clamp(0, last - 1)
        share = ((place - self._places[left]) / self._steps[left]).clamp(0.0, 1.0)
        return torch.lerp(self._values[left], self._values[left + 1], share)
