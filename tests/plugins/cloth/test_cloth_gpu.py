"""The same on a GPU: the CPU's numbers, nothing that waits, recordings of the caller's."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
import torch
from cloth_models import MODELS, everything
from on_gpu import same_bits_again, steps_without_waiting
from sheets import VARY, pushed, run, sheet, simulator, tube
from torch import Tensor

from understudy.testing import check_simulator
from understudy_cloth.mesh import SHARED_VERTICES, WEIGHTED_VERTICES
from understudy_cloth.scene import Capsule, ClothModel, Tool

pytestmark = pytest.mark.gpu


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("traversal", ["block", "launches"])
def test_conforms(model: str, traversal: Any) -> None:
    found = simulator(
        MODELS[model](), 4, "cuda", substeps=6, period=0.003, every=4, traversal=traversal
    )
    check_simulator(found, 4, VARY)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("traversal", ["block", "launches"])
def test_the_first_steps_are_the_cpus(model: str, traversal: Any) -> None:
    """Later, contacts part what rounding has parted."""
    found = []
    for device in ("cpu", "cuda"):
        one = simulator(MODELS[model](), 3, device, traversal=traversal)
        one.step(pushed(one))
        found.append(one.snapshot())
    for name in ("cloth_position", "tool_position"):
        if name in found[0]:
            torch.testing.assert_close(
                found[0][name], found[1][name].cpu(), atol=2e-5, rtol=1e-3, msg=name
            )


def test_both_traversals_are_close() -> None:
    """In shared memory and in global memory, with a thread each or several vertices a thread."""
    # the third fits into shared memory without weights, the last not at all
    for n, m in ((8, 9), (40, 40), (56, 56), (66, 66)):
        x, faces = sheet(n, m)
        found = []
        for traversal in ("block", "launches"):
            one = simulator(ClothModel(x, faces, pinned=(0, n - 1)), 2, "cuda", traversal=traversal)
            found.append(run(one, 3))
            assert one.report() == {}
        assert np.abs(found[0] - found[1]).max() < 2e-5, (n, m)
    assert 66 * 66 > SHARED_VERTICES > 56 * 56 > WEIGHTED_VERTICES > 40 * 40


def test_the_same_bits_again() -> None:
    def bits() -> dict[str, Tensor]:
        one = simulator(everything(), 64, "cuda")
        for _ in range(60):
            one.step(pushed(one))
        return one.snapshot()

    same_bits_again(bits)


def test_layers_stay_apart() -> None:
    x, faces = tube(16, 40, 0.0573)
    x -= (x[:, 0].mean(), 0.0, 0.0)
    log = Tool((Capsule(0.05, 0.5, orientation=(np.sqrt(0.5), np.sqrt(0.5), 0, 0)),), (0, 0, -0.12))
    found = simulator(ClothModel(x, faces, tools=(log,)), 2, "cuda")
    y = run(found, 100, 0.0, 0.0, -0.12)
    upper, lower = y.reshape(40, 16, 3)[:, 4], y.reshape(40, 16, 3)[:, 12]
    assert np.linalg.norm(upper - lower, axis=1).min() > 0.01


def test_a_step_does_not_wait_for_the_device() -> None:
    found = simulator(everything(), 8, "cuda")
    steps_without_waiting(found, pushed(found))


def test_a_step_goes_into_a_recording_of_the_callers() -> None:
    found, plain = simulator(everything(), 4, "cuda"), simulator(everything(), 4, "cuda")
    for one in (found, plain):
        one.step(pushed(one))
    begin = found.snapshot()
    target = pushed(found)
    stream = torch.cuda.Stream()
    graph = torch.cuda.CUDAGraph()
    with torch.cuda.graph(graph, stream=stream):
        found.step(target)
    found.restore(begin)
    for _ in range(3):
        graph.replay()
        plain.step(target)
    assert torch.equal(found.read("cloth_position"), plain.read("cloth_position"))
