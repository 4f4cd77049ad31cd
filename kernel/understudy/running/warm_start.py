"""What one run takes from the state of another, and whether it fits."""

from __future__ import annotations

import sys
from collections.abc import Iterator, Mapping
from typing import Any

import torch
from torch import Tensor

from understudy.errors import RunError
from understudy.records import runs
from understudy.task import Curriculum, InitialStates, State

__all__ = ["load_part", "misshapen", "newest_state"]


def newest_state(path: str) -> State:
    """The state of the newest intact checkpoint of the run folder `path`."""
    state, _ = runs.open_run(path).newest(lambda text: print(text, file=sys.stderr))
    return state


def load_part(part: Curriculum | InitialStates, state: State, name: str, what: str) -> None:
    """Put what a checkpoint's `state` says of the environment's part `name` into `part`.

    Raises
    ------
    RunError
        if it says nothing that fits; calls it `what`.
    """
    try:
        given = state["environment"][name]
        for misfit in misshapen(part.state_dict(), given, name):
            raise ValueError(misfit)
        part.load_state_dict(given)
    except (LookupError, ValueError, TypeError, RuntimeError) as error:
        raise RunError(f"{what} do not fit those of this task: {error}.") from error


def misshapen(own: Any, other: Any, where: str) -> Iterator[str]:
    """The places at which a nested state is not what `own` is, or not finite where `own` is."""
    if own is None:
        return
    if _kind(own) != _kind(other):
        yield f"'{where}' is {_kind(own)} here and {_kind(other)} there"
    elif isinstance(own, Mapping):
        for name, value in own.items():
            yield from misshapen(value, other.get(name), f"{where}/{name}".lstrip("/"))
    elif not isinstance(own, (str, list)):
        finite = [bool(torch.as_tensor(value).isfinite().all()) for value in (own, other)]
        if finite == [True, False]:
            yield f"'{where}' is not finite"


def _kind(value: Any) -> str:
    if isinstance(value, Tensor):
        return f"{tuple(value.shape)} {value.dtype}".replace(" torch.float32", "")
    kinds = {"NoneType": "nothing", "int": "a number", "float": "a number", "tuple": "a list"}
    return kinds.get(type(value).__name__, f"a {type(value).__name__}")
