"""Several processes, one GPU each, started by ``torchrun``. A single process is a group of one.

Each process owns ``num_worlds`` worlds; process r's are worlds r·N to r·N + N - 1 of the random
streams. Gradients and statistics are averaged over processes; process 0 alone decides, and writes.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator

import torch
import torch.distributed as dist
from torch import Tensor

from understudy.errors import TrainingError, said

__all__ = ["add_up", "anyone", "decided", "rank", "size", "total"]


def size() -> int:
    """How many processes train together."""
    return dist.get_world_size() if dist.is_initialized() else 1


def rank() -> int:
    """This process's number in the group, 0 where there is none."""
    return dist.get_rank() if dist.is_initialized() else 0


def total(value: Tensor) -> Tensor:
    """The sum of `value` over processes."""
    if size() > 1:
        value = value.clone()
        add_up(value)
    return value


def add_up(values: Tensor) -> None:
    """The sum over processes in place of `values`."""
    with _lost_processes():
        dist.all_reduce(values)


@contextlib.contextmanager
def _lost_processes() -> Iterator[None]:
    try:
        yield
    except RuntimeError as error:  # which torch raises when nobody answers
        raise TrainingError(
            f"Another process of this training ended or does not answer ({said(error)}). What was "
            "saved stays: start as many processes again, of `understudy resume` with the run's folder."
        ) from error


def decided(choice: int, device: torch.device) -> int:
    """Process 0's `choice`, everywhere."""
    if size() == 1:
        return choice
    box = torch.tensor(choice, device=device)
    with _lost_processes():
        dist.broadcast(box, 0)
    return int(box)


def anyone(flag: bool, device: torch.device) -> bool:
    """Whether `flag` is true in any process."""
    return bool(total(torch.tensor(float(flag), device=device)) > 0)
