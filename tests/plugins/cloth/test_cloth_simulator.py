"""What every simulator keeps, and what this one says of itself."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from cloth_models import ARM, FLOOR, MODELS, everything, hung
from on_gpu import cuda_code
from sheets import PUSH, VARY, control, pushed, run, sheet, simulator
from torch import Tensor

from understudy.errors import ConfigError
from understudy.testing import check_simulator
from understudy_cloth import mesh
from understudy_cloth.mesh import SHARED_VERTICES, WEIGHTED_VERTICES
from understudy_cloth.scene import Capsule, ClothModel, Grip, Tool
from understudy_cloth.solver import build_kernels
from understudy_cloth.world import Features


@pytest.mark.parametrize("model", MODELS)
@pytest.mark.parametrize("traversal", ["block", "launches"])
def test_conforms(model: str, traversal: Any) -> None:
    found = simulator(MODELS[model](), 4, substeps=6, period=0.003, every=4, traversal=traversal)
    check_simulator(found, 4, VARY)


@pytest.mark.parametrize("model", MODELS)
def test_both_traversals_are_the_same_numbers(model: str) -> None:
    found = []
    for traversal in ("block", "launches"):
        one = simulator(MODELS[model](), 2, traversal=traversal)
        target = pushed(one)
        for _ in range(8):
            one.step(target)
        found.append(one.snapshot())
    assert not torch.equal(found[0]["cloth_position"][0], torch.zeros(()))
    for name, value in found[0].items():
        assert torch.equal(value, found[1][name]), name


def test_no_result_depends_on_the_order_within_a_colour(monkeypatch: pytest.MonkeyPatch) -> None:
    def positions() -> Tensor:
        found = simulator(everything())
        for _ in range(5):
            found.step(pushed(found))
        return found.read("cloth_position").clone()

    sorted_ones = positions()
    for found in (mesh.distances_of, mesh.hinges_of):  # as on a GPU
        at = f"understudy_cloth.simulator.{found.__name__}"
        monkeypatch.setattr(at, lambda f, c, _, found=found: found(f, c, True))
    assert torch.equal(positions(), sorted_ones)


def test_the_same_bits_again_whatever_other_worlds_do() -> None:
    def fallen(worlds: int) -> Tensor:
        found = simulator(everything(), worlds)
        x = found.read("cloth_position").clone()
        x[1:] += torch.rand(x[1:].shape, generator=torch.Generator().manual_seed(0)) * 0.01
        state = {name: found.read(name) for name in found.state_fields}
        found.set_state(torch.ones(worlds, dtype=torch.bool), {**state, "cloth_position": x})
        run(found, 20, *PUSH)
        return found.read("cloth_position")[0].clone()

    assert torch.equal(fallen(1), fallen(1))
    assert torch.equal(fallen(1), fallen(3))


def test_restored_in_the_middle_of_anything_it_continues_bit_for_bit() -> None:
    """Between searches, layers in contact, grips closed: nothing that decides the future is left out."""
    one, other = simulator(everything(), 3), simulator(everything(), 3)
    target = pushed(one)
    for _ in range(12):
        one.step(target)
    one.step(target, 7)
    kept = one.snapshot()
    away = {name: other.read(name).clone() for name in other.state_fields}
    away["cloth_position"] += 5.0  # nothing is near it there
    other.set_state(torch.ones(3, dtype=torch.bool), away)
    other.step(control(other) + 0.05)
    other.restore(kept)
    for found in (one, other):
        found.step(target, 13)
        for _ in range(5):
            found.step(target)
    for name, value in one.snapshot().items():
        assert torch.equal(value, other.snapshot()[name]), name
    assert (kept["contact_force"] != 0).any()


def test_fields_are_views_that_follow() -> None:
    found = simulator(hung())
    x = found.read("cloth_position")
    before = x.clone()
    run(found, 2)
    assert found.read("cloth_position").data_ptr() == x.data_ptr()
    assert not torch.equal(x, before)
    assert torch.equal(x[:, [0, 8]], before[:, [0, 8]]), "pinned vertices move"


def test_a_world_that_is_not_finite_fails_alone() -> None:
    found, clean = simulator(everything(), 3), simulator(everything(), 3)
    state = {name: found.read(name).clone() for name in found.state_fields}
    for name, value in (("cloth_position", torch.nan), ("cloth_velocity", 2e3)):
        broken = {key: each.clone() for key, each in state.items()}
        broken[name][1, 5, 1] = value
        for each, begin in ((found, broken), (clean, state)):
            each.set_state(torch.ones(3, dtype=torch.bool), begin)
            run(each, 2, *PUSH)
        assert found.failed().tolist() == [False, True, False]
        others = torch.tensor([True, False, True])
        assert torch.equal(
            found.read("cloth_position")[others], clean.read("cloth_position")[others]
        )


def test_a_tool_that_is_sent_nowhere_spoils_its_world_alone() -> None:
    found = simulator(everything(), 2)
    target = pushed(found)
    target[1, 0] = torch.nan
    found.step(target)
    found.step(pushed(found))
    assert found.failed().tolist() == [False, True]


def test_too_many_candidates_are_counted() -> None:
    x, faces = sheet(6, 6, z=0.01)
    y, more = sheet(6, 6)
    model = ClothModel(np.concatenate([x, y]), np.concatenate([faces, more + 36]))
    few = simulator(model, candidates=2)
    assert few.report() == {}
    run(few, 1)
    assert few.report()["candidates_left_out"] > 0
    enough = simulator(model)
    run(enough, 1)
    assert enough.report() == {}


def test_worlds_differ_in_parameters() -> None:
    """Each changes what happens in its world, and in no other."""
    values = {
        "gravity": torch.tensor([[0.0, 0.0, -9.81], [0.0, 0.0, -3.0]]),
        "friction": torch.tensor([0.5, 0.0]),
        "density": torch.tensor([0.2, 0.4]),
        "stretch": torch.tensor([1e4, 1e1]),
        "shear": torch.tensor([1e3, 1e1]),
        "bending": torch.tensor([1e-5, 1e-2]),
    }
    for name, value in values.items():
        found, plain = simulator(everything(), 2), simulator(everything(), 2)
        found.vary([name])
        state = {field: found.read(field).clone() for field in found.state_fields}
        found.set_state(torch.ones(2, dtype=torch.bool), {**state, name: value})
        for each in (found, plain):
            run(each, 20, *PUSH)
        x, y = found.read("cloth_position"), plain.read("cloth_position")
        assert torch.equal(x[0], y[0]), name
        assert (x[1] - y[1]).abs().max() > 1e-4, name


@pytest.mark.parametrize(
    ("changes", "says"),
    [
        ({"pinned": (0, 81)}, "pinned"),
        ({"pinned": (0, 0)}, "twice"),
        ({"tools": (ARM,), "grips": (Grip(1, (3,)),)}, "tool 1"),
        ({"tools": (ARM,), "grips": (Grip(0, (0, 3)),)}, "pinned"),
        ({"rest": np.zeros((5, 3))}, "rest shape"),
        ({"tools": (Tool((Capsule(0.1, 0.1),) * 32),)}, "32 shapes"),
        ({"rest": np.zeros((81, 3))}, "area at rest"),
    ],
)
def test_a_scene_that_cannot_be_is_refused(changes: Mapping[str, Any], says: str) -> None:
    with pytest.raises(ConfigError, match=says):
        simulator(hung(**changes))


def test_the_scene_describes_itself() -> None:
    from sheets import Scene

    said = Scene(everything()).describe()
    assert said == {"vertices": 120, "triangles": 198, "tools": 2, "grips": 2}
    assert FLOOR in everything().tools


@pytest.mark.parametrize(
    "features",
    [
        Features(True, True, True, shared=SHARED_VERTICES, weighted=False, threads=512),
        Features(True, True, True, shared=WEIGHTED_VERTICES, weighted=True, threads=512),
        Features(False, False, False, shared=0, weighted=False, threads=512),
    ],
)
def test_kernels_compile_for_cuda(features: Features, tmp_path: Path) -> None:
    """Whatever machine this is: the compiler needs no GPU."""
    code = cuda_code(build_kernels(features).block.module, features.threads, tmp_path)
    assert "bar.sync" in code
    assert ("ld.shared" in code) == (features.shared > 0), "positions are not where they should be"
    assert ("ld.shared.v4" in code) == features.weighted, "not read at once"
