"""What the model is trained on: the newest decisions, as its inputs and targets, on the device."""

from __future__ import annotations

import torch
from torch import Tensor

from understudy.task import State


class Replay:
    """A ring of `size` rows. Rows whose numbers are not finite are kept as zeros that do not count."""

    def __init__(self, size: int, inputs: int, targets: int, device: torch.device) -> None:
        self._inputs = torch.zeros(size, inputs, device=device)
        self._targets = torch.zeros(size, targets, device=device)
        self._counts = torch.zeros(size, device=device)
        self.seen = 0  #: rows since the start

    def __len__(self) -> int:
        return min(self.seen, len(self._counts))

    def add(self, inputs: Tensor, targets: Tensor) -> None:
        """Rows (B, D) and (B, E) in the place of the oldest."""
        size, self.seen = len(self._counts), self.seen + len(inputs)
        inputs, targets = inputs[-size:], targets[-size:]
        sound = inputs.isfinite().all(1) & targets.isfinite().all(1)
        rows = (torch.arange(len(inputs), device=inputs.device) + self.seen - len(inputs)) % size
        self._inputs[rows] = torch.where(sound.unsqueeze(1), inputs, 0.0)
        self._targets[rows] = torch.where(sound.unsqueeze(1), targets, 0.0)
        self._counts[rows] = sound.float()

    def sound(self) -> tuple[Tensor, Tensor]:
        """All rows that count."""
        rows = self._counts[: len(self)] > 0
        return self._inputs[: len(self)][rows], self._targets[: len(self)][rows]

    def draw(self, count: int, generator: torch.Generator) -> tuple[Tensor, Tensor, Tensor]:
        """`count` rows, each of the present ones as likely; and (count,) whether it counts, 1 or 0."""
        rows = torch.randint(len(self), (count,), generator=generator, device=self._counts.device)
        return self._inputs[rows], self._targets[rows], self._counts[rows]

    def _rows(self) -> dict[str, Tensor]:
        kept = len(self)
        own = {"inputs": self._inputs, "targets": self._targets, "counts": self._counts}
        return {name: value[:kept] for name, value in own.items()} if kept else {}

    def state_dict(self) -> State:
        return {"seen": self.seen, "rows": {k: v.clone() for k, v in self._rows().items()}}

    def load_state_dict(self, state: State) -> None:
        """Restore what :meth:`state_dict` returned; ValueError if that is of another ring."""
        self.seen = int(state["seen"])
        if self.seen < 0:
            raise ValueError(f"the replay has seen {self.seen} decisions")
        for name, mine in self._rows().items():
            value = state["rows"][name]
            if value.shape != mine.shape or not value.isfinite().all():
                raise ValueError(f"the replay's '{name}' do not fit: {tuple(value.shape)}")
            mine.copy_(value)
