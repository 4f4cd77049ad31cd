"""What every simulator keeps, and what this one says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from granular import MASS, RADIUS, Scene, control, run, simulator
from on_gpu import cuda_code
from particle_models import BLOCK, MODELS, SCRAPER, everything, grains
from torch import Tensor

from understudy.errors import ConfigError, UnderstudyError
from understudy.task import Simulator
from understudy.testing import check_simulator
from understudy_pbd.scene import Fluid, Material, ParticleModel, Springs
from understudy_pbd.simulator import ParticleSimulator
from understudy_pbd.solver import build_kernels
from understudy_pbd.world import SHARED_PARTICLES, Features


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("traversal", ["block", "launches"])
def test_conforms(model: str, traversal: Any) -> None:
    vary = ["gravity", "friction", "cohesion", "viscosity", "active_particles"]
    check_simulator(simulator(MODELS[model](), 4, traversal=traversal), 4, vary)


@pytest.mark.parametrize("model", MODELS)
def test_both_traversals_are_the_same_numbers(model: str) -> None:
    found = []
    for traversal in ("block", "launches"):
        one = simulator(MODELS[model](), 2, traversal=traversal)
        target = control(one, *([0.02, 0.0, 0.03, 0.0, 0.0, 0.5] * 2)[: one.control_size])
        for _ in range(10):
            one.step(target)
        found.append(one.snapshot())
    for name, value in found[0].items():
        assert torch.equal(value, found[1][name]), name


def test_the_same_bits_again_whatever_other_worlds_do() -> None:
    def heap(worlds: int) -> Tensor:
        found = simulator(grains(), worlds)
        x = found.read("particle_position").clone()
        x[1:] += torch.rand(x[1:].shape, generator=torch.Generator().manual_seed(0)) * 0.01
        state = {name: found.read(name) for name in found.state_fields}
        found.set_state(torch.ones(worlds, dtype=torch.bool), {**state, "particle_position": x})
        return run(found, 30, 0.05, 0.0, 0.03, 0.0, 0.0, 1.0)[0].clone()

    assert torch.equal(heap(1), heap(1))
    assert torch.equal(heap(1), heap(3))


def test_fields_are_views_that_follow() -> None:
    found = simulator(grains())
    x, tool = found.read("particle_position"), found.read("tool_position")
    before = x.clone()
    run(found, 5, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0)
    assert found.read("particle_position").data_ptr() == x.data_ptr()
    assert not torch.equal(x, before)
    assert torch.allclose(tool, torch.tensor([[0.0, 0.0, 0.03]]), atol=1e-6)


def test_a_tool_moves_evenly_and_arrives() -> None:
    found = simulator(grains(gravity=(0, 0, 0)), substeps=5)
    turn = torch.tensor([0.3, -0.4, 1.2])
    target = control(found, 0.1, 0.2, 0.53, *turn.tolist())
    places = []
    for _ in range(5):
        found.step(target, 1)
        places.append(found.read("tool_position")[0].clone())
    begin = torch.tensor(SCRAPER.position)
    expected = torch.stack([torch.lerp(begin, target[0, :3], (k + 1) / 5) for k in range(5)])
    assert torch.allclose(torch.stack(places), expected, atol=1e-6)
    angle = float(turn.norm())
    half = torch.cat([torch.tensor([np.cos(angle / 2)]), turn / angle * np.sin(angle / 2)]).float()
    assert torch.allclose(found.read("tool_orientation")[0], half, atol=1e-5)
    assert torch.allclose(found.read("tool_angular_velocity")[0], turn * 60, rtol=1e-3)
    velocity = (target[0, :3] - begin) * 60
    assert torch.allclose(found.read("tool_velocity")[0], velocity, rtol=1e-3)
    found.step(target)  # already there
    assert found.read("tool_velocity").abs().max() < 1e-4


def test_inactive_particles_touch_nobody() -> None:
    found = simulator(grains(tools=()), 2)
    found.vary(["active_particles"])
    active = torch.ones(2, 27)
    active[0, 9:18] = 0
    state = {name: found.read(name) for name in found.state_fields}
    found.set_state(torch.ones(2, dtype=torch.bool), {**state, "active_particles": active})
    begin = found.read("particle_position").clone()
    x = run(found, 20)
    assert torch.equal(x[0, 9:18], begin[0, 9:18])
    assert (found.read("particle_velocity")[0, 9:18] == 0).all()
    alone = simulator(
        ParticleModel(np.delete(BLOCK, np.s_[9:18], axis=0), RADIUS, MASS, tools=()), 1
    )
    assert torch.equal(x[0, active[0] > 0], run(alone, 20)[0])


def test_a_particle_without_mass_stays() -> None:
    mass = np.full(27, MASS)
    mass[13] = 0.0
    x = run(simulator(ParticleModel(BLOCK, RADIUS, mass), 1), 20)
    assert torch.allclose(x[0, 13], torch.tensor(BLOCK[13]).float())
    assert x[0, :, 2].min() > 0.9 * RADIUS


@pytest.mark.parametrize("fluid", [None, Fluid(1000.0, 4 * RADIUS)])
def test_particles_in_one_place_come_apart(fluid: Fluid | None) -> None:
    found = simulator(
        ParticleModel(
            np.full((27, 3), 0.05), RADIUS, 0.008, materials=(Material(0.4, fluid=fluid),)
        )
    )
    x = run(found, 10)[0]
    assert not found.failed().any()
    apart = torch.cdist(x, x) + torch.eye(27)
    assert apart.min() > 1.2 * RADIUS


def test_a_world_that_is_not_finite_fails_alone() -> None:
    found = simulator(grains(), 3)
    state = {name: found.read(name).clone() for name in found.state_fields}
    state["particle_position"][1, 5] = torch.nan
    found.set_state(torch.tensor([False, True, False]), state)
    run(found, 2, 0.0, 0.0, 0.03, 0.0, 0.0, 0.0)
    assert found.failed().tolist() == [False, True, False]


def test_too_many_neighbours_are_counted() -> None:
    found = simulator(grains(), neighbours=3)
    assert found.report() == {}
    run(found, 2, -0.1, 0.0, 0.03, 0.0, 0.0, 0.0)
    assert found.report()["neighbour_overflows"] > 0


def test_worlds_differ_in_parameters() -> None:
    found: Simulator = simulator(grains(tools=()), 2)
    found.vary(["gravity"])
    state = {name: found.read(name).clone() for name in found.state_fields}
    gravity = torch.tensor([[0.0, 0.0, -9.81], [0.0, 0.0, 0.0]])
    found.set_state(torch.ones(2, dtype=torch.bool), {**state, "gravity": gravity})
    assert isinstance(found, ParticleSimulator)
    x = run(found, 10)
    assert x[0, :, 2].mean() < x[1, :, 2].mean() - 0.001


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"radius": 0.0}, "positive radius"),
        ({"mass": np.ones(3)}, "shape"),
        ({"material": 1}, "material"),
        ({"springs": Springs(np.array([[0, 27]]), np.ones(1))}, "does not have"),
        ({"springs": Springs(np.array([[0, 1], [0, 2]]), np.ones(2), slots=1)}, "slots=1"),
        ({"springs": Springs(np.array([[0, 1]]), np.zeros(1))}, "lengths"),
    ],
)
def test_a_scene_that_cannot_be_is_refused(changes: Mapping[str, Any], says: str) -> None:
    model = ParticleModel(**{"positions": BLOCK, "radius": RADIUS, "mass": MASS, **changes})
    with pytest.raises(ConfigError, match=says):
        simulator(model)


def test_it_is_drawn(tmp_path: Path) -> None:
    found, scene = simulator(everything()), Scene(everything())
    tracks: dict[str, list[np.ndarray]] = {name: [] for name in scene.recorded}
    for _ in range(2):
        run(found, 5, *([0.0, 0.0, 0.05, 0.0, 0.0, 0.0] * 2))
        for name, track in tracks.items():
            track.append(found.read(name)[0].numpy().copy())
    try:
        frames = list(scene.draw({name: np.array(t) for name, t in tracks.items()}, 160, 120))
    except UnderstudyError as error:
        pytest.skip(str(error))
    assert [frame.shape for frame in frames] == [(120, 160, 3)] * 2
    assert all(frame.dtype == np.uint8 and frame.std() > 10 for frame in frames)
    assert not np.array_equal(frames[0], frames[1])
    assert scene.describe()["particles"] == 45


@pytest.mark.parametrize(
    "features",
    [
        Features(fluids=False, springs=False, alike=True, shared=256, threads=224),
        Features(fluids=True, springs=True, alike=False, shared=SHARED_PARTICLES, threads=256),
    ],
)
def test_kernels_compile_for_cuda(features: Features, tmp_path: Path) -> None:
    """Whatever machine this is: the compiler needs no GPU."""
    kernels = build_kernels(features)
    for name in ("block", "solve"):
        code = cuda_code(getattr(kernels, name).module, features.threads, tmp_path)
        if name == "block":
            assert "bar.sync" in code
            assert "ld.shared.v4" in code, "positions are not where they were meant to be"


def test_parameters_are_restored_too() -> None:
    """In the worlds that are asked for, as they were in the snapshot."""
    found = simulator(grains(), 3)
    found.vary(["gravity"])
    every = torch.ones(3, dtype=torch.bool)
    state = {name: found.read(name).clone() for name in found.state_fields}
    gravity = torch.tensor([[0.0, 0.0, -1.0], [0.0, 0.0, -2.0], [0.0, 0.0, -3.0]])
    found.set_state(every, {**state, "gravity": gravity})
    snapshot = {name: value.clone() for name, value in found.snapshot().items()}
    found.set_state(every, {**state, "gravity": torch.zeros(3, 3)})
    found.restore(snapshot, torch.tensor([True, False, True]))
    assert found.read("gravity")[:, 2].tolist() == [-1.0, 0.0, -3.0]
    found.restore(snapshot)
    assert found.read("gravity")[:, 2].tolist() == [-1.0, -2.0, -3.0]
