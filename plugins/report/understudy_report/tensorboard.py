"""Metrics for TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from understudy.records.observer import RunObserver
from understudy.records.runs import Run

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter


class TensorBoard(RunObserver):
    """Writes each metric against the samples consumed, into ``tensorboard/`` of the run."""

    def __init__(self) -> None:
        self._writer: SummaryWriter | None = None

    def started(self, run: Run) -> None:
        from torch.utils.tensorboard.writer import SummaryWriter  # seconds, for trainings only

        rows = run.metrics()
        step = int(rows[-1]["samples"]) + 1 if rows else None
        self._writer = SummaryWriter(str(run.path / "tensorboard"), purge_step=step)

    def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
        if self._writer is not None:
            for name, value in row.items():
                if name not in ("iteration", "samples"):
                    self._writer.add_scalar(name, value, int(row["samples"]))

    def finished(self, run: Run, outcome: str) -> None:
        if self._writer is not None:
            self._writer.close()
