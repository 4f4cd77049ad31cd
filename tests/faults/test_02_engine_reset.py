"""Fault 2: a state in which MuJoCo would silently reset counts as a failure, never as a teleport."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import pytest
import torch
from mujoco.batch import SimulationError
from worlds import PADDLE_TASK, SMALL, Direct

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import box


@pytest.mark.parametrize("value", [float("nan"), 1e12])
@pytest.mark.parametrize("field", ["qpos", "qvel"])
def test_the_engine_does_not_reset(plugins: Plugins, field: str, value: float) -> None:
    simulator = build_environment(
        load_experiment([*PADDLE_TASK, *SMALL], plugins)
    ).context.simulator
    assert simulator is not None
    simulator._views[field][5, 2] = value  # type: ignore[attr-defined]
    simulator.step(torch.zeros(16, 1))
    assert simulator.failed().tolist() == [i == 5 for i in range(16)]
    state = np.concatenate([simulator.read("qpos"), simulator.read("qvel")], axis=1)[5]
    assert not (np.abs(state) < 1e10).all(), "the engine put the world somewhere else"


def test_even_if_it_did(plugins: Plugins) -> None:
    """With the engine's automatic reset on, only its warning tells; it must be enough."""
    simulator = build_environment(
        load_experiment([*PADDLE_TASK, *SMALL], plugins)
    ).context.simulator
    assert simulator is not None
    simulator.batch.expand("opt.disableflags")[:] &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # type: ignore[attr-defined]
    simulator._views["qpos"][5, 2] = float("nan")  # type: ignore[attr-defined]
    simulator.step(torch.zeros(16, 1))
    assert torch.isfinite(simulator.read("qpos")).all()
    assert simulator.failed().tolist() == [i == 5 for i in range(16)]


def test_report_counts_warnings(plugins: Plugins) -> None:
    simulator = build_environment(
        load_experiment([*PADDLE_TASK, *SMALL], plugins)
    ).context.simulator
    assert simulator is not None
    simulator._views["qvel"][3, 0] = float("inf")  # type: ignore[attr-defined]
    simulator.step(torch.zeros(16, 1))
    assert simulator.failed()[3]
    count = simulator.report()["badqvel"]
    assert count >= 1
    state = {"qpos": simulator.read("qpos")[:1].repeat(16, 1), "qvel": torch.zeros(16, 7)}
    simulator.set_state(torch.ones(16, dtype=torch.bool), state)
    assert simulator.report()["badqvel"] == count, "beginning anew forgets nothing"


def test_no_teleport_inside_an_episode(plugins: Plugins) -> None:
    """All numbers are finite after the engine's reset, and yet the episode ends as a failure."""
    environment = build_environment(load_experiment([*PADDLE_TASK, *SMALL], plugins)).environment
    simulator = environment.parts.simulator
    simulator.batch.expand("opt.disableflags")[:] &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)  # type: ignore[attr-defined]
    environment.reset()
    simulator._views["qpos"][5, 2] = 1e12  # type: ignore[attr-defined]
    step = environment.step(torch.zeros(16, 1))
    assert step.failed.tolist() == step.terminated.tolist() == [i == 5 for i in range(16)]
    assert environment.episode_step.tolist() == [0 if i == 5 else 1 for i in range(16)]
    assert step.rewards[5] == 0


class Every(Direct):
    """Computes the control as often as told."""

    def __init__(self, every: Any) -> None:
        self.action_space, self.every = box(1), every


@pytest.mark.parametrize("period", ["first", "last"])
@pytest.mark.parametrize("every", ["decision", "period", "substep"])
@pytest.mark.parametrize("decision", [1, 2, 3])
def test_no_teleport_at_any_clock(plugins: Plugins, decision: int, every: str, period: str) -> None:
    """In whichever control period of a decision the engine resets: the episode fails."""
    task = [*PADDLE_TASK, *SMALL, f"control.decision={decision}"]
    environment = build_environment(load_experiment(task, plugins)).environment
    environment.parts.actuation = dataclasses.replace(
        environment.parts.actuation, part=Every(every)
    )
    simulator: Any = environment.parts.simulator
    simulator.batch.expand("opt.disableflags")[:] &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    environment.reset()
    step, calls = simulator.step, []
    count = decision * (5 if every == "substep" else 1)

    def poisoned(control: torch.Tensor, substeps: int | None = None) -> None:
        calls.append(substeps)
        if len(calls) == (1 if period == "first" else count):
            simulator._views["qvel"][5, 2] = 1e12
        step(control, substeps)

    simulator.step = poisoned
    judged = environment.step(torch.zeros(16, 1))
    assert len(calls) == count
    assert judged.failed.tolist() == judged.unsound.tolist() == [i == 5 for i in range(16)]
    assert int(environment.quarantined) == 1
    assert not environment.step(torch.zeros(16, 1)).failed.any(), "it has begun anew"


def test_marks_outlast_several_steps(plugins: Plugins) -> None:
    """Until they are read or the world's state is set, for those who ask less often."""
    simulator: Any = build_environment(
        load_experiment([*PADDLE_TASK, *SMALL], plugins)
    ).context.simulator
    simulator.batch.expand("opt.disableflags")[:] &= ~int(mujoco.mjtDisableBit.mjDSBL_AUTORESET)
    start = simulator.snapshot()
    for state_is_set in (False, True):
        simulator._views["qpos"][5, 2] = 1e12
        for _ in range(3):
            simulator.step(torch.zeros(16, 1))
        if state_is_set:
            simulator.restore(start)
        assert simulator.failed().tolist() == [i == 5 and not state_is_set for i in range(16)]
        simulator.step(torch.zeros(16, 1))
        assert not simulator.failed().any()


class Troubled:
    """An engine that ends its steps with an error in world 5."""

    def __init__(self, batch: Any) -> None:
        self._batch = batch
        self.status = np.arange(batch.nsim) == 5

    def __getattr__(self, name: str) -> Any:
        return getattr(self._batch, name)

    def step(self, **options: Any) -> None:
        self._batch.step(**options)
        raise SimulationError(np.array([5]), "mj_stackAlloc: out of memory")


def test_an_error_of_the_engine_is_its_worlds_failure(plugins: Plugins) -> None:
    environment = build_environment(load_experiment([*PADDLE_TASK, *SMALL], plugins)).environment
    environment.reset()
    simulator: Any = environment.parts.simulator
    engine, simulator.batch = simulator.batch, Troubled(simulator.batch)
    assert environment.step(torch.zeros(16, 1)).failed.tolist() == [i == 5 for i in range(16)]
    simulator.batch = engine
    assert not environment.step(torch.zeros(16, 1)).failed.any()


def test_warnings_are_written_nowhere(
    plugins: Plugins, capfd: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    """However many there are: they are counted."""
    simulator = build_environment(
        load_experiment([*PADDLE_TASK, *SMALL], plugins)
    ).context.simulator
    assert simulator is not None
    for _ in range(20):
        simulator._views["qvel"][3, 0] = float("inf")  # type: ignore[attr-defined]
        simulator.step(torch.zeros(16, 1))
    assert simulator.report()["badqvel"] >= 20
    assert capfd.readouterr() == ("", "")
    assert not list(tmp_path.iterdir()), "the working folder has no MUJOCO_LOG.TXT"
