"""Sequences of Warp's kernels on torch's stream, each captured once as a CUDA graph."""

from __future__ import annotations

import gc
import os
import shutil
import tempfile
import warnings
from collections.abc import Callable, Hashable, Iterable
from typing import Any

import torch
import warp as wp
from torch import Tensor

from understudy_warp_torch.compiling import compile_kernels
from understudy_warp_torch.headers import keep_headers

__all__ = ["Kernels", "put_rows"]


def start_warp() -> None:
    """Initialise Warp, with a kernel cache that can be written.

    Where the usual folder (``$WARP_CACHE_PATH``, or the user's cache) cannot be written, what it
    holds is copied to a temporary one, so that a read-only but warm cache keeps its use.
    """
    wp.config.log_level = wp.LOG_WARNING
    keep_headers()
    try:
        wp.init()
        folder = wp.config.kernel_cache_dir
        if folder is not None and os.access(folder, os.W_OK):
            return
        reason = f"{folder} cannot be written"
    except OSError as error:
        folder, reason = None, str(error)
    temporary = tempfile.mkdtemp(prefix="understudy-kernels-")
    if folder is not None and os.path.isdir(folder):
        shutil.copytree(folder, temporary, dirs_exist_ok=True)
    wp.config.kernel_cache_dir = temporary
    wp.init()
    warnings.warn(
        f"No kernel cache to write ({reason}); using {temporary}, so the next start compiles again. "
        "Set WARP_CACHE_PATH to a folder that can be written.",
        stacklevel=2,
    )


class Kernels:
    """Runs Warp's kernels on `device` so that they and torch's keep their order.

    Work is one CUDA graph, captured when it is first run. While the caller captures a graph of its
    own, the kernels go into that one. On the CPU they simply run.
    """

    def __init__(self, device: torch.device) -> None:
        start_warp()
        if device.type == "cuda" and device.index is None:  # Warp wants it said
            device = torch.device("cuda", torch.cuda.current_device())
        self.device = device
        self._graphs: dict[Hashable, Any] = {}  #: None on the CPU, where there are none
        self._outer: list[Any] = []
        self._streams: dict[int, Any] = {}

    def scope(self) -> Any:
        """Warp's default device is this one, within ``with``."""
        return wp.ScopedDevice(wp.device_from_torch(self.device))

    def run(
        self,
        key: Hashable,
        work: Callable[[], None],
        state: Iterable[Tensor],
        derive: Callable[[], None] = lambda: None,
    ) -> None:
        """Do `work`, a sequence of kernels that is the same whenever `key` is.

        `state` are the tensors that it changes and reads again. Kernels must be compiled before
        they can be captured, so the first time they run once in vain, and these are put back; `derive` computes
        anew what `work` reads beside them.
        """
        if self.device.type != "cuda":
            if key not in self._graphs:
                self._compile(work, list(state), derive)
                self._graphs[key] = None
            with self.scope():
                work()
        elif torch.cuda.is_current_stream_capturing():
            with (
                self._on_stream(),
                wp.ScopedCapture(
                    external=True, force_module_load=False, capture_mode=wp.CaptureMode.GLOBAL
                ) as capture,
            ):
                work()
            self._outer.append(capture.graph)  # keeps the kernels' code loaded
        else:
            if key not in self._graphs:
                self._graphs[key] = self._capture(work, list(state), derive)
            with self._on_stream():
                wp.capture_launch(self._graphs[key])

    def forget(self) -> None:
        """Record all work anew: what it consists of has changed."""
        self._graphs.clear()

    def _compile(
        self, work: Callable[[], None], state: list[Tensor], derive: Callable[[], None]
    ) -> None:
        before = [view.clone() for view in state]
        with self.scope():
            compile_kernels(work, wp.device_from_torch(self.device))
        for view, value in zip(state, before, strict=True):
            view.copy_(value)
        with self.scope():
            derive()

    def _capture(
        self, work: Callable[[], None], state: list[Tensor], derive: Callable[[], None]
    ) -> Any:
        before = [view.clone() for view in state]
        with self._on_stream():
            compile_kernels(work, wp.device_from_torch(self.device))
            work()
        for view, value in zip(state, before, strict=True):
            view.copy_(value)
        with self._on_stream():
            derive()
        gc.collect()  # another capture that is freed during this one would end it
        with self.scope(), wp.ScopedCapture() as capture:
            work()
        return capture.graph

    def _on_stream(self) -> Any:
        """Let Warp use torch's stream."""
        stream = torch.cuda.current_stream(self.device)
        if stream.cuda_stream not in self._streams:
            self._streams[stream.cuda_stream] = wp.stream_from_torch(stream)
        # Warp's own stream has nothing that this one would have to wait for
        return wp.ScopedStream(self._streams[stream.cuda_stream], sync_enter=False)


def put_rows(view: Tensor, worlds: Tensor, values: Tensor) -> None:
    """Write the rows of `values` (N or 1, …) where `worlds` (N,) is true, in place."""
    rows = worlds.view(-1, *([1] * (view.dim() - 1)))
    torch.where(rows, values.to(view.device, view.dtype), view, out=view)
