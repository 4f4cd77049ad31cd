"""Joining the processes that ``torchrun`` started, one GPU each, and leaving them."""

from __future__ import annotations

import os
from datetime import timedelta

import torch
import torch.distributed as dist

from understudy.errors import ConfigError

__all__ = ["requested"]


def requested() -> int:
    """How many processes ``torchrun`` started."""
    return int(os.environ.get("WORLD_SIZE", "1"))


def start(device: str) -> None:
    """Join the other processes, if there are any."""
    if requested() == 1 or dist.is_initialized():
        return
    on_gpu = device.startswith("cuda")
    local = int(os.environ.get("LOCAL_RANK", "0"))
    if on_gpu:
        if local >= torch.cuda.device_count():
            raise ConfigError(
                f"torchrun started {requested()} processes and this host has "
                f"{torch.cuda.device_count()} GPUs. Start one process a GPU (--nproc-per-node)."
            )
        torch.cuda.set_device(local)
    patience = timedelta(seconds=float(os.environ.get("UNDERSTUDY_PATIENCE", "1800")))
    dist.init_process_group("nccl" if on_gpu else "gloo", timeout=patience)


def stop() -> None:
    """Leave the group, if there is one."""
    if dist.is_initialized():
        dist.destroy_process_group()
