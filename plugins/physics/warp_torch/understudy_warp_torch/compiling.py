"""Warp compiles a kernel's module when it is first launched, one after the other; here side by side."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from concurrent.futures import FIRST_EXCEPTION, Future, ThreadPoolExecutor, wait
from contextlib import contextmanager
from typing import Any

import warp as wp

from understudy.command.command import tell

__all__ = ["compile_kernels"]

#: Seconds of waiting before anything is said (a cache that is full loads faster), and between lines.
_QUIET, _PAUSE = 3.0, 10.0
#: Threads; each takes some hundred MB.
_MOST = 32


def compile_kernels(work: Callable[[], None], device: Any) -> None:
    """Compile and load every module that `work` launches kernels of, on all processors at once.

    `work` is gone through once without launching, so what it allocates and copies is done, and both
    ways of each of Warp's conditions are. Modules compile in threads: only Python's part of it, a
    tenth, is one after the other. Says on stderr what is waited for where it takes a while.

    Parameters
    ----------
    device
        Warp's.
    """
    modules = list(_modules_of(work))
    began = time.monotonic()
    with ThreadPoolExecutor(min(_MOST, os.cpu_count() or 1)) as pool:
        waiting: set[Future[None]] = {
            pool.submit(wp.force_load, device, [module], block_dim, 0)
            for module, block_dim in modules
        }
        pause = _QUIET
        while waiting:
            done, waiting = wait(waiting, pause, FIRST_EXCEPTION)
            for future in done:
                future.result()
            if waiting:
                _tell(time.monotonic() - began, len(modules) - len(waiting), len(modules))
                pause = _PAUSE


def _tell(seconds: float, ready: int, count: int) -> None:
    tell(
        f"Compiling the simulator's kernels, once a machine, about a minute: "
        f"{ready} of {count} modules after {seconds:.0f} s"
    )


def _modules_of(work: Callable[[], None]) -> dict[tuple[Any, int | None], None]:
    """The modules that `work` launches kernels of, each with the size of its blocks, in their order."""
    found: dict[tuple[Any, int | None], None] = {}

    def load(module: Any, device: Any, block_dim: int | None = None, **_: Any) -> None:
        found[module, block_dim] = None  # and nothing is returned, so nothing is launched

    def size(kernel: Any, device: Any = None) -> tuple[int, int]:
        if wp.get_device(device).is_cpu:
            return 1, 1
        found[kernel.module, None] = None
        return 256, 132  # any: it sizes grids, which are not launched

    ways = {"capture_while": _loop, "capture_if": _branch, "get_suggested_block_size": size}
    with _replaced(wp.Module, load=load), _replaced(wp, **ways):
        work()
    return found


def _loop(condition: Any, while_body: Any, stream: Any = None, **arguments: Any) -> None:
    while_body(**arguments)


def _branch(
    condition: Any, on_true: Any = None, on_false: Any = None, stream: Any = None, **arguments: Any
) -> None:
    for way in (on_true, on_false):
        if way is not None:
            way(**arguments)


@contextmanager
def _replaced(owner: Any, **values: Any) -> Iterator[None]:
    before = {name: getattr(owner, name) for name in values}
    try:
        for name, value in values.items():
            setattr(owner, name, value)
        yield
    finally:
        for name, value in before.items():
            setattr(owner, name, value)
