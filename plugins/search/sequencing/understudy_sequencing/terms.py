"""Terms of sequences: towards where the next subtask begins, and how far a state machine has come."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_skills import bank


class NextStart:
    """−‖x − μ‖, (N,): how far a field is from its mean over a bank (r_r of Algorithm 1, line 2). Read it as
    ``reads: {value: FIELD}``."""

    @dataclass(frozen=True)
    class Options:
        file: str  #: the bank of the next subtask's starts, or the folder of the run that has one
        field: str = "qpos"  #: of the bank, the same as is read

    def __init__(self, options: Options, context: Context) -> None:
        states = bank.fitting(options.file, context, "reward 'sequencing/next_start'")
        if options.field not in states:
            raise ConfigError(
                f"reward 'sequencing/next_start': the bank {options.file} has no '{options.field}', but "
                f"{', '.join(sorted(states))}."
            )
        self._where = f"reward 'sequencing/next_start': {options.field} of {options.file}"
        self._mean = states[options.field].float().mean(dim=0).to(context.device)

    def __call__(self, value: Tensor) -> Tensor:
        if value.shape[1:] != self._mean.shape:
            raise ConfigError(
                f"{self._where} has the shape {tuple(self._mean.shape)}, and what is read "
                f"{tuple(value.shape[1:])}: read the same field of the same scene."
            )
        return -(value - self._mean).flatten(1).norm(dim=1)


def finished(stage: Tensor, stage_count: Tensor) -> Tensor:
    """(N,) bool: all stages are done."""
    return stage >= stage_count


def overtime(
    stage: Tensor,
    stage_seconds: Tensor,
    stage_limit: Tensor,
    *,
    only: int | None = None,  #: the stage that is judged, from 0; null is any
) -> Tensor:
    """(N,) bool: the stage that is at work has had its time."""
    late = stage_seconds >= stage_limit
    return late if only is None else late & (stage == only)


def completed(
    stage: Tensor,
    *,
    number: int,  #: of the stage, from 0
) -> Tensor:
    """(N,) 1 once the stage is done."""
    return (stage > number).float()
