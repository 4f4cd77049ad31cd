"""Fault 4: particles that fly apart end the episode in that step, though every number is finite."""

from __future__ import annotations

import sys
from pathlib import Path
from typing import Any

import pytest
import torch
from counted_task import line, term
from torch import Tensor

from understudy.random import WorldStreams
from understudy.running.environment import Environment
from understudy.task import Actuation, Encoder, InitialStates, box

pytest.importorskip("warp", reason="Warp is not installed (pip install 'understudy[pbd]')")
sys.path.append(str(Path(__file__).resolve().parents[1] / "plugins" / "pbd"))
N, BAD = 4, 2


class Heap(InitialStates):
    """As the scene has it."""

    def __init__(self, simulator: Any) -> None:
        self._state = {name: simulator.read(name).clone() for name in simulator.state_fields}

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return self._state


class Centre(Encoder):
    reads = ("particle_position",)
    shape = (3,)

    def encode(self, particle_position: Tensor) -> Tensor:
        return particle_position.mean(1)


class Idle(Actuation):
    action_space = box(1)

    def control(self, action: Tensor) -> Tensor:
        return action[:, :0]


def height(particle_position: Tensor) -> Tensor:
    return particle_position[:, :, 2].mean(1)


@pytest.fixture
def environment() -> Environment:
    from granular import simulator
    from particle_models import grains

    made = simulator(grains(tools=()), N)
    return line(
        worlds=N, substeps=4, simulator=made, initial_states=Heap(made), actuation=Idle(),
        encoders={"centre": Centre()}, rewards=[term(height)], control_dt=1 / 60,
    )  # fmt: skip


@pytest.mark.parametrize(
    ("field", "value"),
    [("particle_velocity", 2e3), ("particle_velocity", -5e4), ("particle_position", 3e3)],
)
def test_the_episode_fails_at_once_and_alone(
    environment: Environment, field: str, value: float
) -> None:
    environment.reset()
    simulator: Any = environment.parts.simulator
    environment.step(torch.zeros(N, 1))
    before = simulator.snapshot()
    clean = environment.step(torch.zeros(N, 1)).observations["centre"].clone()
    simulator.restore(before)
    state = {name: simulator.read(name).clone() for name in simulator.state_fields}
    state[field][BAD, 5, 1] = value
    simulator.set_state(torch.arange(N) == BAD, state)
    step = environment.step(torch.zeros(N, 1))
    assert torch.isfinite(simulator.read("particle_position")).all()
    assert step.failed.tolist() == step.terminated.tolist() == [i == BAD for i in range(N)]
    assert step.rewards[BAD] == 0
    assert int(environment.quarantined) == 1
    assert environment.episode_step[BAD] == 0
    others = torch.arange(N) != BAD
    assert torch.equal(step.observations["centre"][others], clean[others])
