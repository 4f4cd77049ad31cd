"""The engine on Warp's CPU device, against plain MuJoCo."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from arena import ARENA, arena, check_derived, check_fields, check_parameters, states

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

import mujoco_warp as mjw
from forms import check_forms
from repeatable import repeatable  # noqa: F401 - a fixture

from understudy.task import Context, Simulator
from understudy.testing import check_simulator
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco_warp.simulator import MujocoWarpSimulator

DEVICES = ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)]


def build(context: Context) -> MujocoWarpSimulator:
    return MujocoWarpSimulator(MujocoWarpSimulator.Options(), context)


@pytest.mark.parametrize("device", DEVICES)
def test_conforms(device: str, request: pytest.FixtureRequest) -> None:
    if device == "cuda":
        request.getfixturevalue("repeatable")
    check_simulator(
        build(arena(4, device)), 4, ["mocap_pos/hand", "geom_size/box", "gravity", "active/shelf"]
    )


class PlainScene(MujocoScene):
    """A ball in the air: no sensor, no actuator, no contact."""

    def spec(self) -> mujoco.MjSpec:
        ball = '<body pos="0 0 1"><freejoint/><geom size=".1"/></body>'
        return mujoco.MjSpec.from_string(f"<mujoco><worldbody>{ball}</worldbody></mujoco>")


def test_conforms_with_next_to_nothing_in_the_scene() -> None:
    context = arena(2)
    context.scene = PlainScene()
    check_simulator(build(context), 2, ["body_mass", "geom_size"])


@pytest.mark.parametrize("device", DEVICES)
def test_fields_of_all_stages_are_those_of_plain_mujoco(device: str) -> None:
    check_fields(build(arena(6, device)), atol=2e-3, rtol=2e-3)


@pytest.mark.parametrize("device", DEVICES)
def test_parameters_are_as_plain_mujoco_computes_them(device: str) -> None:
    check_parameters(build, device, steps=20, atol=1e-3)


def test_what_derives_from_a_parameter_follows_it() -> None:
    def field(simulator: Simulator, name: str, world: int) -> np.ndarray:
        assert isinstance(simulator, MujocoWarpSimulator)
        array = getattr(simulator._m, name).numpy()
        return array[world % len(array)]

    check_derived(build, field)


@pytest.mark.parametrize("device", DEVICES)
def test_acceleration_is_computed_only_once_it_is_read(device: str) -> None:
    simulator = build(arena(2, device))
    simulator.step(torch.ones(2, 1, device=device))
    force = simulator._views["actuator_force"].clone()
    simulator.set_state(torch.ones(2, dtype=torch.bool, device=device), states(2, device))
    assert torch.equal(simulator._views["actuator_force"], force), "work that nobody asked for"
    assert not torch.equal(simulator.read("actuator_force"), force)


@pytest.mark.parametrize("device", DEVICES)
def test_each_world_has_a_form_of_its_own(device: str) -> None:
    check_forms(build, device, steps=8, atol=2e-3)


@pytest.mark.parametrize("device", DEVICES)
def test_controls_are_0_unless_they_are_given(device: str) -> None:
    simulator = build(arena(2, device))
    everywhere = torch.ones(2, dtype=torch.bool, device=device)
    state = states(2, device)
    simulator.set_state(everywhere, {**state, "ctrl": torch.full((2, 1), 0.5, device=device)})
    assert torch.equal(simulator.read("ctrl"), torch.full((2, 1), 0.5, device=device))
    simulator.set_state(everywhere, state)
    assert torch.equal(simulator.read("ctrl"), torch.zeros(2, 1, device=device))


class Integrated(MujocoScene):
    """The arena, integrated in another way."""

    def __init__(self, integrator: mujoco.mjtIntegrator) -> None:
        self.integrator = integrator

    def spec(self) -> mujoco.MjSpec:
        spec = mujoco.MjSpec.from_string(ARENA)
        spec.option.integrator = self.integrator
        return spec


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("integrator", ["IMPLICITFAST", "DISCRETE", "EULER", "RK4"])
@pytest.mark.parametrize("read", ["actuator_length", "qacc"])
def test_what_is_read_changes_nothing_of_the_motion(
    read: str, integrator: str, device: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The velocity stage of the state reached is the first half of the next step."""

    def build_one() -> MujocoWarpSimulator:
        context = arena(3, device)
        context.scene = Integrated(getattr(mujoco.mjtIntegrator, f"mjINT_{integrator}"))
        return build(context)

    halves = []
    second = mjw.step2
    monkeypatch.setattr(mjw, "step2", lambda m, d: (halves.append(1), second(m, d)))
    plain, halved = build_one(), build_one()
    halved.read(read)
    some = torch.tensor([True, False, True], device=device)
    begun = {simulator: simulator.snapshot() for simulator in (plain, halved)}
    for call in range(6):
        for simulator in (plain, halved):
            if call == 2:
                simulator.set_state(some, states(3, device))
            if call == 4:
                simulator.restore(begun[simulator], ~some)
            simulator.step(torch.full((3, 1), 0.5 * (-1) ** call, device=device), 1 + call % 2)
        for name in ("qpos", "qvel"):
            torch.testing.assert_close(halved.read(name), plain.read(name), atol=1e-4, rtol=1e-4)
    split = read == "actuator_length" and integrator != "RK4"
    assert bool(halves) == split
