"""Whether a step can be captured as a CUDA graph, found without a GPU.

On the CPU nothing that waits for the device is seen to do so. Here every operation of a step is looked
at on its way to torch: those that would fetch something to the host, or bring something from it, are
refused.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any

import numpy as np
import torch
from torch import Tensor
from torch.overrides import TorchFunctionMode
from torch.utils._python_dispatch import TorchDispatchMode, _disable_current_modes

from understudy.running.environment import Environment

#: Python's ways out of a tensor, and into one. Some of them torch does not dispatch on the CPU.
_CALLS: dict[Any, str] = {
    Tensor.tolist: ".tolist()",
    Tensor.item: ".item()",
    Tensor.numpy: ".numpy()",
    Tensor.cpu: ".cpu()",
    Tensor.__array__: "numpy of a tensor",
    Tensor.__bool__: "a branch on a tensor",
    Tensor.__int__: "int() of a tensor",
    Tensor.__float__: "float() of a tensor",
    Tensor.__index__: "an index that is a tensor",
    Tensor.new_tensor: "a tensor made of numbers",
    torch.tensor: "a tensor made of numbers",
    torch.from_numpy: "a tensor made of numpy's",
}
_ITEMS = {Tensor.__getitem__, Tensor.__setitem__}
#: What torch itself computes on the host, or whose result has a size that the host must know.
_OPERATIONS = {
    "_local_scalar_dense": "a number fetched from a tensor",
    "is_nonzero": "a branch on a tensor",
    "equal": "torch.equal",
    "nonzero": "nonzero",
    "masked_select": "masked_select",
    "_unique2": "unique",
    "unique_dim": "unique",
    "unique_consecutive": "unique_consecutive",
    "bincount": "bincount",
    "repeat_interleave": "repeat_interleave of a tensor",
    "_linalg_check_errors": "a matrix operation that checks for errors",
    "_linalg_svd": "svd",
    "_linalg_eigh": "eigh",
    "linalg_lstsq": "lstsq",
}
_INDEXING = {"index", "index_put", "index_put_", "_index_put_impl_"}


class _Calls(TorchFunctionMode):
    def __torch_function__(
        self, function: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        if function in _CALLS:
            raise AssertionError(_waits(_CALLS[function]))
        if function is torch.as_tensor and not isinstance(args[0], Tensor):
            raise AssertionError(_waits(_CALLS[torch.tensor]))
        if function in _ITEMS and _has_list(args[1]):
            raise AssertionError(_waits("indexing with a list"))
        return function(*args, **(kwargs or {}))


class _Operations(TorchDispatchMode):
    def __torch_dispatch__(
        self, function: Any, types: Any, args: tuple[Any, ...] = (), kwargs: Any = None
    ) -> Any:
        name = function.overloadpacket.__name__
        if name in _OPERATIONS and function.namespace == "aten":
            raise AssertionError(_waits(_OPERATIONS[name]))
        if name in _INDEXING and any(i is not None and i.dtype == torch.bool for i in args[1]):
            raise AssertionError(_waits("indexing with a mask"))
        return function(*args, **(kwargs or {}))


def _has_list(index: object) -> bool:
    items = index if isinstance(index, tuple) else (index,)
    return any(isinstance(item, list | np.ndarray) for item in items)


def _waits(what: str) -> str:
    return f"{what} in a step waits for the device: it cannot be captured as a CUDA graph"


@contextmanager
def nothing_waits() -> Iterator[None]:
    """Inside, operations of torch that wait for a device raise AssertionError, on any device."""
    with _Calls(), _Operations():
        yield


def check_capturable(environment: Environment, steps: int = 2) -> None:
    """The parts of a task compute all of a step on the device: terms, fields, encoders, actuation,
    memories, initial states and curriculum, also where episodes end. The simulator is left out.
    """
    environment.reset()
    simulator = environment.parts.simulator
    hidden = {name: getattr(simulator, name) for name in _SIMULATION}
    fault, environment.on_quarantine = environment.on_quarantine, None
    for name, method in hidden.items():
        setattr(simulator, name, _unwatched(method))
    try:
        action = torch.zeros(
            environment.num_worlds, environment.action_size, device=environment.device
        )
        every_other = torch.arange(environment.num_worlds, device=environment.device) % 2 == 0
        environment.step(action)  # what is made once, at the first step, is made
        environment.begin(every_other)
        for _ in range(steps):
            with nothing_waits():
                environment.advance(action)
                environment.begin(every_other)
    finally:
        for name in hidden:
            delattr(simulator, name)
        environment.on_quarantine = fault


_SIMULATION = ("read", "set_state", "step", "failed", "snapshot", "restore")


def _unwatched(method: Callable[..., Any]) -> Callable[..., Any]:
    """`method` with no torch mode at work."""

    def call(*args: Any, **options: Any) -> Any:
        with torch._C.DisableTorchFunction(), _disable_current_modes():
            return method(*args, **options)

    return call
