"""Fault 6: dumps reproduce the failure bit for bit; the normaliser survives extreme inputs."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
import torch
from counted_task import LINE_TASK, Push, Starts, line_plugins
from worlds import PADDLE_TASK, SMALL, make_training, same_bits

from understudy.errors import RunError
from understudy.records import checkpoint
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_inspect.replay import replay_step
from understudy_networks.nn import RunningNormaliser


def test_engine_failure_replays(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A box thrown so fast that it diverges within the step; its neighbours do not matter."""
    training = make_training(plugins, [*PADDLE_TASK, *SMALL], tmp_path / "run")
    simulator = training.job.environment.parts.simulator
    training.iterate()
    after: dict[str, torch.Tensor] = {}
    step = simulator.step

    def remembered(control: torch.Tensor, substeps: int | None = None) -> None:
        step(control, substeps)
        if not after:
            after.update(simulator.snapshot())

    for world in (3, 11):
        simulator._views["qvel"][world, :3] = (0, 0, -9.9e9)  # type: ignore[attr-defined]
    monkeypatch.setattr(simulator, "step", remembered)
    training.iterate()
    replayed = replay_step(tmp_path / "run/faults/step", plugins)
    assert replayed.worlds.tolist() == [3, 11]
    assert replayed.failed.all()
    for name, value in replayed.snapshot.items():
        there = after[name][replayed.worlds]
        assert value.numpy().tobytes() == there.numpy().tobytes(), name


def test_sound_worlds_replay_bitwise(plugins: Plugins, tmp_path: Path) -> None:
    """Other worlds in the batch change no bit: dump two that are well, in the middle of contacts."""
    training = make_training(plugins, [*PADDLE_TASK, *SMALL], tmp_path / "run")
    training.iterate()
    environment, rows = training.job.environment, torch.arange(16) % 7 == 2
    simulator = environment.parts.simulator
    before, control = simulator.snapshot(), torch.linspace(-3, 3, 16).unsqueeze(1)
    fault = {
        "snapshot": {name: value[rows] for name, value in before.items()},
        "controls": control[rows].unsqueeze(0),
        "substeps": None,
        "worlds": rows.nonzero().squeeze(1),
    }
    environment.on_quarantine(fault)
    simulator.step(control)
    replayed = replay_step(tmp_path / "run/faults/step", plugins)
    assert not replayed.failed.any()
    assert torch.equal(replayed.snapshot["state"], simulator.snapshot()["state"][rows])


def test_bad_control_replays(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.job.environment.reset()
    action = torch.zeros(16, 1)
    action[4] = 1e12
    training.job.environment.step(action)
    replayed = replay_step(tmp_path / "run/faults/step.json", plugins)
    assert replayed.worlds.tolist() == [4]
    assert replayed.failed.all()


class Swing(Push):
    """Pushes further away, anew from each state that it sees."""

    reads = ("x",)
    every = "substep"

    def control(self, action: torch.Tensor, x: torch.Tensor) -> torch.Tensor:
        return action + 3.1 * x


class Gains(Starts):
    """Worlds differ in their gains, and are anywhere up to 4e6."""

    varies = ("gain",)

    def sample(self, streams: Any, **fields: torch.Tensor) -> dict[str, torch.Tensor]:
        return {"x": 4e6 * streams.uniform(1), "gain": 0.5 + streams.uniform(1)[:, 0]}


@pytest.mark.parametrize("every", ["substep", "period", "decision"])
def test_every_control_of_a_decision_replays(tmp_path: Path, every: str) -> None:
    """Two control periods of three sub-steps; worlds that go wrong in any of them, and differ."""
    swing: Any = type("Any", (Swing,), {"every": every, "__doc__": "x"})
    plugins = line_plugins(actuation={"my/swing": swing}, initial_states={"my/gains": Gains})
    overrides = [*LINE_TASK, "actuation={name: my/swing}", "initial_states={name: my/gains}",
                 "num_worlds=64", "control.decision=2", "control.substeps=3"]  # fmt: skip
    training = make_training(plugins, overrides, tmp_path / "run")
    environment = training.job.environment
    for _ in range(10):
        step = environment.advance(torch.full((64, 1), 1e6))
        if step.unsound.any():
            break
        assert environment.on_quarantine is not None
    assert 0 < int(step.unsound.sum()) < 64
    assert environment.on_quarantine is None, "once"
    after = environment.parts.simulator.snapshot()
    replayed = replay_step(tmp_path / "run/faults/step", plugins)
    assert torch.equal(replayed.worlds, step.unsound.nonzero().squeeze(1))
    assert replayed.failed.all()
    for name, value in replayed.snapshot.items():
        assert same_bits(value, after[name][replayed.worlds]), name
    state, _ = checkpoint.load(tmp_path / "run/faults/step")
    count = {"substep": 6, "period": 2, "decision": 2}[every]
    assert state["controls"].shape == (count, len(replayed.worlds), 1)


def test_only_the_first_failure_is_dumped(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.job.environment.reset()
    for world in (4, 9):
        action = torch.zeros(16, 1)
        action[world] = float("nan")
        training.job.environment.step(action)
    state, meta = checkpoint.load(tmp_path / "run/faults/step")
    assert state["worlds"].tolist() == [4]
    assert meta["config"]["seed"] == 0
    assert (
        meta["versions"]["torch"] == torch.__version__.partition("+")[0]
        or meta["versions"]["torch"]
    )


def test_no_dump(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="cannot be read"):
        replay_step(tmp_path / "step")


@pytest.mark.parametrize("value", [0.0, 7.0, -3e9, 1e9])
def test_normaliser_constant_input(value: float) -> None:
    normaliser = RunningNormaliser(3)
    for _ in range(50):
        normaliser.observe(torch.full((64, 3), value))
    out = normaliser(torch.full((5, 3), value))
    assert torch.isfinite(out).all()
    assert (out.abs() <= 5).all()
    assert torch.isfinite(normaliser(torch.full((5, 3), -value))).all()


def test_normaliser_huge_and_tiny_columns() -> None:
    generator = torch.Generator().manual_seed(0)
    scale = torch.tensor([1e-9, 1.0, 9e9])
    normaliser = RunningNormaliser(3)
    for _ in range(200):
        normaliser.observe(torch.randn(256, 3, generator=generator) * scale)
    out = normaliser(torch.randn(4096, 3, generator=generator) * scale)
    assert torch.isfinite(out).all()
    assert (out[:, 1:].std(0) - 1).abs().max() < 0.05
    assert normaliser(torch.full((1, 3), 1e25)).max() <= 5
    assert out[:, 0].abs().max() < 1e-3, "noise far below the floor is not blown up"


def test_normaliser_a_billion_samples() -> None:
    """After 1e9 samples at an offset of 1e6 the statistics are still those of the input."""
    generator = torch.Generator().manual_seed(0)
    normaliser = RunningNormaliser(1)
    normaliser.count.fill_(1e9)
    normaliser.mean.fill_(1e6 + 1)  # a share of 4096 / 1e8 of the error goes with each batch
    normaliser.variance.fill_(4.0)
    for _ in range(1000):
        normaliser.observe(1e6 + 2 * torch.randn(4096, 1, generator=generator))
    assert float(normaliser.count) == normaliser.horizon
    assert abs(float(normaliser.mean) - 1e6 - (1 - 4096e-8) ** 1000) < 0.01
    assert abs(float(normaliser.variance) - 4.0) < 0.05
    for _ in range(3000):  # and it still follows a change
        normaliser.observe(torch.full((100_000, 1), 5.0))
    assert abs(float(normaliser.mean) - 5.0) < 0.1 * 1e6
