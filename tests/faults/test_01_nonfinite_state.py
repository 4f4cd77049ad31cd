"""Fault 1: one world's numbers go wrong; its episode fails, and nobody else notices."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from worlds import PADDLE_TASK, SMALL, flat, low, make_training

from understudy.running.environment import Environment
from understudy.running.step import Step
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.task import Rollout
from understudy.testing.fake import FAKE_TASK

BAD = 5
VALUES = [float("nan"), float("inf"), -float("inf"), 1e12]


def environment(plugins: Plugins, task: Any = PADDLE_TASK) -> Environment:
    made = build_environment(load_experiment([*task, *SMALL], plugins)).environment
    made.reset()
    return made


def roll(env: Environment, steps: int, seed: int) -> list[Step]:
    generator = torch.Generator().manual_seed(seed)
    return [
        env.step(torch.randn(env.num_worlds, env.action_size, generator=generator))
        for _ in range(steps)
    ]


def assert_only_bad_failed(clean: list[Step], hurt: list[Step]) -> None:
    """In the first step the bad world failed; the others are the same to the last bit, always."""
    others = torch.arange(16) != BAD
    assert hurt[0].failed[BAD]
    assert hurt[0].terminated[BAD]
    assert not hurt[0].truncated[BAD]
    assert hurt[0].rewards[BAD] == 0
    for one, two in zip(clean, hurt, strict=True):
        for tensor in (
            *two.observations.values(),
            *(two.final_observations or {}).values(),
            two.rewards,
        ):
            assert torch.isfinite(tensor).all()
            assert (tensor.abs() < 1e10).all()
        assert torch.equal(one.observations["state"][others], two.observations["state"][others])
        assert torch.equal(one.rewards[others], two.rewards[others])
        assert torch.equal(one.truncated[others], two.truncated[others])
        assert torch.equal(one.terminated[others], two.terminated[others])


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("where", ["qpos", "qvel", "ctrl"])
@pytest.mark.parametrize("decision", [1, 3])
def test_physics_state(plugins: Plugins, decision: int, where: str, value: float) -> None:
    task = (*PADDLE_TASK, f"control.decision={decision}")
    clean, hurt = environment(plugins, task), environment(plugins, task)
    roll(clean, 3, 0), roll(hurt, 3, 0)
    generator = torch.Generator().manual_seed(1)
    action = torch.randn(16, 1, generator=generator)
    bad_action = action.clone()
    if where == "ctrl":
        bad_action[BAD] = value
    else:
        hurt.parts.simulator._views[where][BAD, 1] = value  # type: ignore[attr-defined]
    first, second = [clean.step(action)], [hurt.step(bad_action)]
    # 40 more steps: every neighbour's episode is truncated and begun anew twice
    assert_only_bad_failed(first + roll(clean, 40, 2), second + roll(hurt, 40, 2))
    assert int(hurt.quarantined) == 1
    assert hurt.statistics.collect()["unsound"] == 1


@pytest.mark.parametrize("value", VALUES)
@pytest.mark.parametrize("where", ["observation", "reward", "sensor", "initial state"])
def test_derived_numbers(plugins: Plugins, where: str, value: float) -> None:
    clean, hurt = environment(plugins), environment(plugins)
    parts = hurt.parts

    def spoil(tensor: torch.Tensor) -> torch.Tensor:
        tensor = tensor.clone()
        tensor[BAD] = value
        return tensor

    def bad_low(qpos: torch.Tensor, sensordata: torch.Tensor) -> torch.Tensor:
        return spoil(low(qpos, sensordata))

    with pytest.MonkeyPatch.context() as patch:
        if where == "observation":
            encoder = parts.encoders["state"].part
            encode = encoder.encode
            patch.setattr(encoder, "encode", lambda **f: spoil(encode(**f)))
        elif where == "reward":
            patch.setattr(
                parts, "rewards", [dataclasses.replace(parts.rewards[0], function=bad_low)]
            )
        elif where == "sensor":
            read = parts.simulator.read
            patch.setattr(
                parts.simulator, "read", lambda n: spoil(read(n)) if n == "sensordata" else read(n)
            )
        else:  # what the world begins with is wrong, and fails at its first step
            sample = parts.initial_states.sample
            patch.setattr(
                parts.initial_states,
                "sample",
                lambda s, **f: {k: spoil(v) for k, v in sample(s, **f).items()},
            )
            clean.reset(3), hurt.reset(3)
            assert torch.isfinite(hurt.observations["state"]).all()
            patch.undo()
        first, second = roll(clean, 1, 1), roll(hurt, 1, 1)
    assert_only_bad_failed(first + roll(clean, 40, 2), second + roll(hurt, 40, 2))


def test_nothing_reaches_the_learner(plugins: Plugins) -> None:
    """Most episodes end soundly, or the training would stop (`test_01_unsound_episodes.py`)."""
    training = make_training(plugins, [*FAKE_TASK, *SMALL, "episode.seconds=0.1"])
    simulator, update = training.job.environment.parts.simulator, training.job.learner.update
    step, count = simulator.step, 0

    def bad_step(control: torch.Tensor, substeps: int | None = None) -> None:
        nonlocal count
        step(control, substeps)
        count += 1
        simulator._state[count % 16, count % 2] = VALUES[count % 4]  # type: ignore[attr-defined]

    def checked_update(rollout: Rollout) -> dict[str, float]:
        for name, value in flat(vars(rollout)).items():
            if isinstance(value, torch.Tensor):
                assert torch.isfinite(value).all(), name
                assert (value.float().abs() < 1e10).all(), name
        return update(rollout)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(simulator, "step", bad_step)
        patch.setattr(training.job.learner, "update", checked_update)
        rows = [training.iterate() for _ in range(10)]
    assert int(training.job.environment.quarantined) == 80
    assert sum(row["episode/unsound"] for row in rows) == 80
    assert all(row["skipped_steps"] == 0 for row in rows)
    for part in ("policy", "learner"):
        for name, value in flat(training.state_dict()[part]).items():
            assert torch.isfinite(torch.as_tensor(value)).all(), name
    assert (training.job.policy.state_dict()["normaliser.mean"].abs() < 10).all()


@pytest.mark.parametrize("value", VALUES)
def test_no_such_control_reaches_the_simulator(
    plugins: Plugins, monkeypatch: pytest.MonkeyPatch, value: float
) -> None:
    env = environment(plugins)
    step, given = env.parts.simulator.step, []

    def seen(control: torch.Tensor, substeps: int | None = None) -> None:
        given.append(control.clone())
        step(control, substeps)

    monkeypatch.setattr(env.parts.simulator, "step", seen)
    action = torch.ones(16, 1)
    action[BAD] = value
    assert env.step(action).failed.tolist() == [i == BAD for i in range(16)]
    assert given[0][:, 0].tolist() == [float(i != BAD) for i in range(16)]
