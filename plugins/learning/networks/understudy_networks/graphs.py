"""Work on a GPU that is captured once and replayed: launching a small kernel costs more than running it."""

from __future__ import annotations

import warnings
from collections.abc import Callable, Mapping

import torch
from torch import Tensor

__all__ = ["Captured"]


class Captured:
    """`work` on a minibatch, replayed as one CUDA graph from its fourth call on.

    The first calls run as they are, on the stream they will be captured on: libraries allocate, and
    autograd's bookkeeping is made, there. What `work` writes it must write in place. On the CPU it
    is simply called. Work that cannot be captured goes on uncaptured, after a warning that says why.
    """

    _WARM_UP = 3

    def __init__(self, work: Callable[[Mapping[str, Tensor]], None], device: torch.device) -> None:
        self._work = work
        self._calls = 0
        self._graph: torch.cuda.CUDAGraph | None = None
        self._inputs: dict[str, Tensor] = {}
        self._stream = torch.cuda.Stream(device) if device.type == "cuda" else None

    def __call__(self, minibatch: Mapping[str, Tensor]) -> None:
        """Run on `minibatch`; all of them must have the same names and shapes."""
        if self._stream is None:
            self._work(minibatch)
            return
        if not self._inputs:
            self._inputs = {name: torch.empty_like(value) for name, value in minibatch.items()}
        for name, value in minibatch.items():
            self._inputs[name].copy_(value)
        if self._graph is not None:
            self._graph.replay()
            return
        self._stream.wait_stream(torch.cuda.current_stream())
        if self._calls < self._WARM_UP:
            with torch.cuda.stream(self._stream):
                self._work(self._inputs)
            torch.cuda.current_stream().wait_stream(self._stream)
        else:
            self._take()
        self._calls += 1

    def _take(self) -> None:
        graph = torch.cuda.CUDAGraph()
        try:
            with torch.cuda.graph(graph, stream=self._stream):
                self._work(self._inputs)
        except RuntimeError as error:
            self._stream = None
            reason = str(error).strip().splitlines()[0]
            warnings.warn(
                f"An update cannot be captured as a CUDA graph, so it takes longer: {reason}",
                stacklevel=3,
            )
            self._work(self._inputs)
            return
        graph.replay()
        self._graph = graph
