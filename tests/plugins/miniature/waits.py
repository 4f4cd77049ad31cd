"""Finds, on a CPU, operations that would make the host wait for a GPU."""

from __future__ import annotations

from typing import Any

import torch
from torch import Tensor
from torch.utils._python_dispatch import TorchDispatchMode

_WAITS = {"_local_scalar_dense", "nonzero", "masked_select", "equal", "unique", "lift_fresh"}


class NoWaits(TorchDispatchMode):
    """Raises at what fetches a number, has a size that depends on values, or copies a Python list."""

    def __torch_dispatch__(self, func: Any, types: Any, args: Any = (), kwargs: Any = None) -> Any:
        name = func.overloadpacket.__name__
        masked = name in ("index", "index_put_") and any(
            isinstance(i, Tensor) and i.dtype == torch.bool for i in args[1]
        )
        if name in _WAITS or masked:
            raise AssertionError(f"{name} would wait for the device")
        return func(*args, **(kwargs or {}))
