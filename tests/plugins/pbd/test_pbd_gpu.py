"""The same on a GPU: the CPU's numbers, nothing that waits, recordings of the caller's."""

from __future__ import annotations

import itertools
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
import torch
from granular import MASS, RADIUS, control, disturbed, lattice, run, simulator
from on_gpu import captured, same_bits_again, steps_without_waiting
from particle_models import MODELS, everything, grains
from torch import Tensor

from understudy.testing import check_simulator
from understudy_pbd.scene import Fluid, Material, ParticleModel, Table
from understudy_pbd.simulator import ParticleSimulator

pytestmark = pytest.mark.gpu

VARY = ["gravity", "friction", "cohesion", "viscosity", "active_particles"]
TRAVERSALS = ["block", "launches"]


def pushed(found: ParticleSimulator) -> Tensor:
    """A control that drives all tools through what is there."""
    return control(found, *([0.02, 0.0, 0.03, 0.0, 0.0, 0.5] * 2)[: found.control_size])


def close(one: dict[str, Tensor], other: dict[str, Tensor], atol: float) -> None:
    for name, value in one.items():
        tolerance = atol / 0.004 if "velocit" in name else atol  # over a sub-step's time
        torch.testing.assert_close(
            value.cpu(), other[name].cpu(), atol=tolerance, rtol=1e-3, msg=name
        )


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_conforms(model: str, traversal: Any) -> None:
    check_simulator(simulator(MODELS[model](), 4, "cuda", traversal=traversal), 4, VARY)


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_the_first_steps_are_the_cpus(model: str, traversal: Any) -> None:
    """Later, contacts part what rounding has parted."""
    found = []
    for device in ("cpu", "cuda"):
        one = simulator(MODELS[model](), 3, device, traversal=traversal)
        one.step(pushed(one))
        found.append(one.snapshot())
    close(*found, atol=2e-5)


@pytest.mark.parametrize("count", [100, 216, 700, 1300])
def test_however_many_particles(count: int) -> None:
    """In shared memory with a thread each or several particles a thread, and in global memory."""
    grid = disturbed(lattice((10, 10, 13), 2 * RADIUS, (0, 0, RADIUS)), 0.02 * RADIUS)[:count]
    found = []
    for device, traversal in (("cpu", "block"), ("cuda", "block"), ("cuda", "launches")):
        one = simulator(ParticleModel(grid, RADIUS, MASS), 2, device, traversal=traversal)
        run(one, 1)
        assert one.report() == {}
        found.append(one.snapshot())
    close(found[0], found[1], atol=2e-5)
    close(found[1], found[2], atol=2e-5)


def test_the_same_bits_again() -> None:
    def bits() -> dict[str, Tensor]:
        one = simulator(everything(), 64, "cuda")
        for _ in range(60):
            one.step(pushed(one))
        return one.snapshot()

    same_bits_again(bits)


def test_a_step_does_not_wait_for_the_device() -> None:
    found = simulator(everything(), 8, "cuda")
    steps_without_waiting(found, pushed(found))


@pytest.mark.parametrize("traversal", TRAVERSALS)
def test_it_is_recorded_in_a_graph_of_the_callers(traversal: Any) -> None:
    n, steps = 32, 20
    found = simulator(everything(), n, "cuda", traversal=traversal)
    found.vary(["gravity"])
    start = found.snapshot()
    generator = torch.Generator().manual_seed(1)
    controls = (0.05 * torch.randn(steps, n, found.control_size, generator=generator)).cuda()
    begins, restores = (torch.rand(2, steps, n, generator=generator) < 0.1).cuda()
    begin = {name: start[name].clone() for name in (*found.state_fields, "gravity")}
    target, begun, restored = controls[0].clone(), begins[0].clone(), restores[0].clone()
    seen = {name: torch.zeros_like(found.read(name)) for name in found.fields}

    def advance() -> None:
        found.step(target)
        found.step(target, substeps=2)
        found.set_state(begun, begin)
        found.restore(start, restored)
        for name, value in seen.items():
            value.copy_(found.read(name) + 0)  # an allocation between, as tasks make

    def trace(step: Callable[[], None]) -> list[dict[str, Tensor]]:
        found.restore(start)
        result = []
        for i in range(steps):
            target.copy_(controls[i])
            begun.copy_(begins[i])
            restored.copy_(restores[i])
            begin["gravity"][:, 2] = -9.81 + 0.1 * i
            step()
            result.append({name: value.clone() for name, value in seen.items()})
        return result

    expected = trace(advance)
    replayed = trace(captured(advance).replay)
    for i, (one, other) in enumerate(zip(expected, replayed, strict=True)):
        for name, value in one.items():
            assert torch.equal(value, other[name]), f"{name} in step {i}"
    assert any(
        (a["particle_position"] != b["particle_position"]).any()
        for a, b in itertools.pairwise(replayed)
    )


def test_a_heap_a_fluid_and_a_scraper() -> None:
    """The physics of the CPU's tests, on many worlds."""
    found = simulator(grains(), 256, "cuda")
    x = run(found, 60, 0.1, 0.0, 0.03, 0.0, 0.0, 0.0)
    assert not found.failed().any()
    assert (RADIUS - x[..., 2]).max() < 0.2 * RADIUS
    q = (x - found.read("tool_position")[:, None]).abs() - torch.tensor([0.005, 0.05, 0.03]).cuda()
    outside = q.clamp(min=0).norm(dim=-1) + q.amax(dim=-1).clamp(max=0)
    assert (RADIUS - outside).max() < 0.2 * RADIUS

    spacing, rest = 0.02, 1000.0
    h, mass, side = 2 * spacing, rest * spacing**3, 7 * spacing
    water = ParticleModel(
        lattice((7, 7, 8), spacing, (0.5 * spacing,) * 3),
        0.5 * spacing,
        mass,
        materials=(Material(0.0, fluid=Fluid(rest, h)),),
        table=Table(0.0, (0.0, 0.0), (side, side)),
    )
    x = run(simulator(water, 16, "cuda"), 120)[7].double()
    r2 = (x[:, None] - x[None]).square().sum(dim=-1)
    rho = mass * (315 / (64 * np.pi * h**9) * (h * h - r2).clamp(min=0) ** 3).sum(dim=1)
    inside = (torch.minimum(x[:, :2], side - x[:, :2]) > h).all(dim=1) & (x[:, 2] > h)
    inside &= x[:, 2] < x[:, 2].quantile(0.98) - h
    assert inside.sum() >= 10
    assert abs(float(rho[inside].mean()) / rest - 1) < 0.02
