"""What tests on a GPU ask of simulators and tasks alike."""

from __future__ import annotations

import contextlib
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest
import torch
import warp as wp
from torch import Tensor

from understudy.running.training import Training
from understudy.task import Simulator


@contextlib.contextmanager
def no_waiting() -> Iterator[None]:
    """Inside, torch raises at any operation that waits for the device."""
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        yield
    finally:
        torch.cuda.set_sync_debug_mode("default")


def steps_without_waiting(found: Simulator, target: Tensor) -> None:
    """Whatever a step may do with `found`, a simulator of 8 worlds."""
    begin = found.snapshot()
    state = {name: begin[name] for name in found.state_fields}
    some = torch.arange(8, device="cuda") % 2 == 0

    def everything() -> None:
        found.step(target)
        found.step(target, 1)
        found.failed()
        found.set_state(some, state)
        found.restore(begin, some)

    everything()  # kernels are loaded
    with no_waiting():
        everything()


def same_bits_again(snapshot: Callable[[], dict[str, Tensor]]) -> None:
    """Twice the same `snapshot`, whose worlds all began alike."""
    first, second = snapshot(), snapshot()
    for name, value in first.items():
        assert torch.equal(value, second[name]), name
        assert torch.equal(value[0], value[-1]), f"worlds that begin alike part in '{name}'"


def captured(advance: Callable[[], None], pool: Any = None) -> torch.cuda.CUDAGraph:
    """`advance` in a graph, once done on the graph's own stream; a `pool` of memory is used for it."""
    graph, stream = torch.cuda.CUDAGraph(), torch.cuda.Stream()
    stream.wait_stream(torch.cuda.current_stream())
    with torch.cuda.stream(stream):
        advance()
    torch.cuda.current_stream().wait_stream(stream)
    within = torch.cuda.use_mem_pool(pool) if pool is not None else contextlib.nullcontext()
    with within, torch.cuda.graph(graph, stream=stream):
        advance()
    return graph


def rollouts_without_waiting(training: Training) -> None:
    """Three iterations, after which steps are captured and a rollout waits for nothing."""
    job: Any = training.job
    row: dict[str, Any] = {}
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="Steps cannot be captured")
        for _ in range(3):
            row = dict(training.iterate())
        assert job.environment.captured_step.on
        assert all(value == value for value in row.values()), row
        with no_waiting():
            job.collector.collect(4)


def cuda_code(module: Any, threads: int, folder: Path) -> str:
    """What Warp's `module` is for a GPU, for which the compiler needs none; skips where there is no compiler."""
    module.options["block_dim"] = threads
    try:
        files = wp.compile_aot_module(module, arch=90, module_dir=folder, use_ptx=True)
    except RuntimeError as error:
        if "nvrtc" in str(error).lower() or "cuda" in str(error).lower():
            pytest.skip(f"no CUDA compiler: {error}")
        raise
    return Path(files[0]).read_text(errors="ignore")
