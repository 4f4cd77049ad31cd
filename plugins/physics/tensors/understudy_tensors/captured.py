"""A step of all worlds, captured once and replayed as one CUDA graph.

A step is hundreds of small kernels, and launching them costs more than running them. Everything a
step reads or changes is therefore a tensor that stays where it is; what it returns is overwritten by
the next replay.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, Generic, TypeVar

import torch
from torch import Tensor

if TYPE_CHECKING:
    from understudy.running.environment import Environment

__all__ = ["Captured"]

T = TypeVar("T")

_WARM_UP = 3


@dataclass(frozen=True)
class _Capture(Generic[T]):
    """A captured step, and the tensors that each replay overwrites."""

    graph: torch.cuda.CUDAGraph
    pool: Any  #: the memory that the capture allocated
    action: Tensor
    result: T
    values: dict[str, Tensor]  #: of the field table after the step
    observations: dict[str, Tensor]
    rewarded: dict[str, Tensor]


class Captured(Generic[T]):
    """`work` on an action (N, A); on a GPU, it is replayed from its fourth call on.

    There is one capture for each number of control periods in a decision. Work that cannot be
    captured, because a part waits for the device, goes on uncaptured, with a warning that says why.
    """

    def __init__(self, work: Callable[[Tensor], T], environment: Environment) -> None:
        self._work, self._environment = work, environment
        self._on = environment.device.type == "cuda"
        self._calls: dict[int, int] = {}
        self._graphs: dict[int, _Capture[T]] = {}
        self._stream = torch.cuda.Stream(environment.device) if self._on else None

    @property
    def on(self) -> bool:
        """Whether the last call's kind of step is replayed by now."""
        return self._environment.decision in self._graphs

    def __call__(self, action: Tensor) -> T:
        environment = self._environment
        if not self._on or environment.on_quarantine or environment.on_period:
            return self._work(action)
        kind = environment.decision
        if kind in self._graphs:
            capture = self._graphs[kind]
            if action.shape != capture.action.shape:  # a copy would spread it over all worlds
                return self._work(action)  # which refuses it
            capture.action.copy_(action)
            capture.graph.replay()
            environment.table.values = dict(capture.values)
            environment.observations = capture.observations
            environment.rewarded = capture.rewarded
            return capture.result
        self._calls[kind] = self._calls.get(kind, 0) + 1
        return self._warm(action) if self._calls[kind] <= _WARM_UP else self._take(action, kind)

    def _warm(self, action: Tensor) -> T:
        """Run `work` as it is, but on the stream of the capture, where libraries then allocate."""
        assert self._stream is not None
        self._stream.wait_stream(torch.cuda.current_stream())
        with torch.cuda.stream(self._stream):
            result = self._work(action)
        torch.cuda.current_stream().wait_stream(self._stream)
        return result

    def _take(self, action: Tensor, kind: int) -> T:
        environment = self._environment
        given, graph, pool = action.clone(), torch.cuda.CUDAGraph(), torch.cuda.MemPool()
        before = dict(environment.table.values)
        try:
            # A pool of its own: a simulator may end and resume the capture, after which torch no
            # longer knows that its allocations belong to it.
            with torch.cuda.use_mem_pool(pool), torch.cuda.graph(graph, stream=self._stream):
                environment.refresh()  # values computed before are not in the capture
                result = self._work(given)
        except RuntimeError as error:
            self._on = False
            environment.table.values = before
            reason = str(error).strip().splitlines()[0]
            warnings.warn(
                f"Steps cannot be captured as a CUDA graph, so they take longer: {reason} The usual "
                "cause is a part that waits for the device (.item(), nonzero, a tensor made of a list).",
                stacklevel=2,
            )
            return self._work(action)
        self._graphs[kind] = _Capture(
            graph,
            pool,
            given,
            result,
            dict(environment.table.values),
            environment.observations,
            environment.rewarded,
        )
        graph.replay()
        return result
