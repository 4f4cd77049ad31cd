"""Joining the processes that ``torchrun`` started, one GPU each, and leaving them."""

from __future__ import annotations

import math
import os
from datetime import timedelta

import torch
import torch.distributed as dist

from understudy.errors import ConfigError

__all__ = ["requested"]

#: What torch reads of the environment to join the others.
_OF_TORCHRUN = ("RANK", "MASTER_ADDR", "MASTER_PORT")


def requested() -> int:
    """How many processes ``torchrun`` started.

    Raises
    ------
    ConfigError
        the variables of the environment are no numbers, or incomplete: something else set them.
    """
    count = int(_number("WORLD_SIZE", 1, least=1))
    if count > 1:
        missing = [name for name in _OF_TORCHRUN if name not in os.environ]
        if missing:
            raise ConfigError(
                f"WORLD_SIZE={count} is in the environment without {', '.join(missing)}, which torchrun sets as well. "
                "Start with torchrun, or unset WORLD_SIZE."
            )
        if _number("RANK", 0, least=0) >= count:
            raise ConfigError(f"RANK={os.environ['RANK']} is not possible: WORLD_SIZE={count}.")
    return count


def _number(name: str, default: int, *, least: int, kind: type[int | float] = int) -> int | float:
    """The number in the variable `name` of the environment."""
    text = os.environ.get(name, str(default))
    try:
        number = kind(text)
    except ValueError:
        number = math.nan
    if not least <= number < 2**31:
        what = "a whole number" if kind is int else "a number"
        raise ConfigError(
            f"{name}={text} in the environment is not possible: it takes {what} from {least} on. Unset it."
        )
    return number


def start(device: str) -> None:
    """Join the other processes, if there are any."""
    if requested() == 1 or dist.is_initialized():
        return
    on_gpu = device.startswith("cuda")
    local = int(_number("LOCAL_RANK", 0, least=0))
    if on_gpu:
        if local >= torch.cuda.device_count():
            raise ConfigError(
                f"torchrun started {requested()} processes and this host has "
                f"{torch.cuda.device_count()} GPUs. Start one process a GPU (--nproc-per-node)."
            )
        torch.cuda.set_device(local)
    patience = timedelta(seconds=_number("UNDERSTUDY_PATIENCE", 1800, least=1, kind=float))
    dist.init_process_group("nccl" if on_gpu else "gloo", timeout=patience)


def stop() -> None:
    """Leave the group, if there is one."""
    if dist.is_initialized():
        dist.destroy_process_group()
