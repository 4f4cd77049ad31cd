"""Metrics for TensorBoard."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import TYPE_CHECKING

from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy_report.values import mapping, number, own_evaluation

if TYPE_CHECKING:
    from torch.utils.tensorboard.writer import SummaryWriter

    from understudy.records.recording import Recording


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

    def judged(self, run: Run, recording: Recording | None, tell: Callable[[str], None]) -> None:
        """The figures of the last evaluation as ``final/…``, beside those of the training."""
        from torch.utils.tensorboard.writer import SummaryWriter

        evaluation = own_evaluation(run)
        samples, rate = number(evaluation.get("samples")), number(evaluation.get("success_rate"))
        means = {
            k: number(mapping(v).get("mean"))
            for k, v in mapping(evaluation.get("measures")).items()
        }
        if samples is not None:
            with SummaryWriter(str(run.path / "tensorboard")) as writer:
                for name, value in {"success_rate": rate, **means}.items():
                    if value is not None:
                        writer.add_scalar(f"final/{name}", value, int(samples))

    def finished(self, run: Run, outcome: str) -> None:
        if self._writer is not None:
            self._writer.close()
