"""Fields of the last sub-step, which cost no forward computation, and what is at a limit, in both engines."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from arena import Arena, arena, everywhere, states

from understudy.task import Context, Simulator
from understudy_mujoco.fields import AT_ITERATIONS, AT_LIMIT, often
from understudy_mujoco.scene import MujocoScene
from understudy_mujoco.simulator import MujocoSimulator

NAMES = ("recent_sensor_touch", "recent_actuator_force", "recent_sensor_force", "recent_qacc")


def on_cpu(context: Context) -> Simulator:
    return MujocoSimulator(MujocoSimulator.Options(threads=1), context)


def on_warp(context: Context) -> Simulator:
    reason = "MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
    module: Any = pytest.importorskip("understudy_mujoco_warp.simulator", reason=reason)
    return module.MujocoWarpSimulator(module.MujocoWarpSimulator.Options(), context)


ENGINES = pytest.mark.parametrize("build", [on_cpu, on_warp])


def plain(state: dict[str, torch.Tensor], control: torch.Tensor, steps: int) -> list[mujoco.MjData]:
    """Plain MuJoCo, whose forces after a step are those of the last sub-step."""
    model = Arena().spec().compile()
    model.opt.timestep = 0.002
    found = []
    for qpos, qvel, u in zip(state["qpos"], state["qvel"], control, strict=True):
        data = mujoco.MjData(model)
        data.qpos, data.qvel, data.ctrl = qpos, qvel, u
        mujoco.mj_step(model, data, steps)
        found.append(data)
    return found


@ENGINES
@pytest.mark.parametrize("present", [False, True])
def test_they_are_what_the_last_sub_step_computed(
    build: Callable[[Context], Simulator], present: bool
) -> None:
    """Whether or not somebody reads the present ones beside them."""
    simulator = build(arena(4))
    for name in NAMES:
        assert (simulator.read(name) == 0).all(), name
    if present:
        simulator.read("qacc"), simulator.read("sensor_touch")
    begin = states(4)
    simulator.set_state(everywhere(simulator), begin)
    control = torch.full((4, 1), 0.3)
    simulator.step(control)
    found = plain(begin, control, 5)
    expected = {
        "recent_sensor_touch": [d.sensor("touch").data for d in found],
        "recent_sensor_force": [d.sensor("force").data for d in found],
        "recent_actuator_force": [d.actuator_force for d in found],
        "recent_qacc": [d.qacc for d in found],
    }
    assert float(simulator.read("recent_sensor_touch").max()) > 1.0
    for name, value in expected.items():
        exact = np.array(value)
        away = np.abs(simulator.read(name).numpy() - exact).max()
        assert away < 2e-3 * max(1.0, np.abs(exact).max()), name


@ENGINES
def test_an_episode_begins_without_what_was_before(build: Callable[[Context], Simulator]) -> None:
    simulator = build(arena(4))
    simulator.read("recent_sensor_touch")
    simulator.set_state(everywhere(simulator), states(4))
    simulator.step(torch.zeros(4, 1))
    before, kept = simulator.read("recent_sensor_touch").clone(), simulator.snapshot()
    some = torch.tensor([True, False, True, False])
    simulator.set_state(some, states(4))
    now = simulator.read("recent_sensor_touch")
    assert (now[some] == 0).all()
    torch.testing.assert_close(now[~some], before[~some])
    simulator.step(torch.zeros(4, 1))
    simulator.restore(kept)
    torch.testing.assert_close(simulator.read("recent_sensor_touch"), before)


class Weak(MujocoScene):
    """The arena with a servo that is weak, and a solver of one iteration."""

    def spec(self) -> mujoco.MjSpec:
        spec = Arena().spec()
        servo = spec.actuator("servo")
        servo.forcerange, servo.forcelimited = [-0.05, 0.05], True
        spec.option.iterations, spec.option.tolerance = 1, 0.0
        return spec


@ENGINES
def test_what_is_at_a_limit_is_counted(build: Callable[[Context], Simulator]) -> None:
    context = arena(4)
    context.scene = Weak()
    simulator = build(context)
    begin = {name: value[3:].expand(4, -1) for name, value in states(4).items()}  # in the floor
    simulator.set_state(everywhere(simulator), begin)
    simulator.step(torch.tensor([[3.0], [-3.0], [3.0], [-3.0]]))
    assert simulator.report() == {AT_ITERATIONS: 4, AT_LIMIT: 4}
    simulator.set_state(everywhere(simulator), states(4))  # the arm bent in each, some in the air
    simulator.step(torch.full((4, 1), 3.0))
    assert simulator.report()[AT_LIMIT] == 8


@ENGINES
def test_what_is_at_no_limit_is_not(build: Callable[[Context], Simulator]) -> None:
    simulator = build(arena(4))
    simulator.step(torch.full((4, 1), 0.1))
    assert simulator.report() == {}


def test_limits_that_are_met_in_passing_are_not_said() -> None:
    """More than one step in twenty, of those of all worlds, and of all actuators."""
    assert often(50, 1000, 1000, 20) == {}
    assert often(51, 1001, 1000, 20) == {AT_ITERATIONS: 51, AT_LIMIT: 1001}
    assert often(0, 0, 0, 0) == {}
