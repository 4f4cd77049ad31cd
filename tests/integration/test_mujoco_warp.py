"""MuJoCo Warp against MuJoCo, and the fault tests that concern the GPU (1, 3, 10, 19, 30).

On a machine without a GPU the simulator runs on Warp's CPU device, slowly; those tests are marked
slow. The tests marked gpu run the same checks where they matter.
"""

from __future__ import annotations

import os
import subprocess
import sys
import warnings
from pathlib import Path

import pytest
import torch

pytest.importorskip("warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')")

from understudy.errors import ConfigError
from understudy.running.training import Training
from understudy.setup.building import Built, build_environment
from understudy.setup.config import load_experiment
from understudy.testing import check_environment

DEVICES = [
    pytest.param("cpu", marks=pytest.mark.slow),
    pytest.param("cuda", marks=pytest.mark.gpu),
]
TASK = ("experiment=spacetime/walk", "learner.minibatches=2", "policy.feedback.hidden=[32]")


def build(device: str, *overrides: str, worlds: int = 8) -> Built:
    fixed = ["simulator=mujoco_warp", f"device={device}", f"num_worlds={worlds}"]
    return build_environment(load_experiment([*TASK, *fixed, *overrides]))


@pytest.mark.parametrize("device", DEVICES)
def test_agrees_with_mujoco_over_a_second(device: str) -> None:
    """Fault 19: the same states under the same targets for 30 control steps (600 physics steps)."""
    reference = build_environment(load_experiment([*TASK, "num_worlds=8"])).environment
    environment = build(device).environment
    reference.reset(seed=3)
    environment.reset(seed=3)
    for _ in range(30):
        targets = reference.table["reference_joint_targets"]
        reference.parts.simulator.step(targets)
        environment.parts.simulator.step(targets.to(environment.device))
    exact = reference.parts.simulator.read("qpos")
    found = environment.parts.simulator.read("qpos").cpu()
    # float32 against float64 over 600 steps with contacts; 1 mm and 1 mrad is what tasks can see
    assert (found - exact).abs().max() < 1e-3


@pytest.mark.parametrize("device", DEVICES)
def test_environment_conforms(device: str) -> None:
    environment = build(device).environment
    environment.reset(seed=0)
    if device == "cpu":
        check_environment(environment, steps=5)
    for _ in range(5):
        step = environment.step(environment.observations["feedforward"])
        assert torch.isfinite(step.rewards).all()


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("value", [float("nan"), float("inf"), 1e12])
def test_a_bad_world_ends_alone(device: str, value: float) -> None:
    """Fault 1: that world fails and begins anew; the others go on; nothing non-finite gets out."""
    environment = build(device).environment
    environment.reset(seed=1)
    environment.parts.simulator.read("qvel")[2, 3] = value
    step = environment.step(environment.observations["feedforward"])
    expected = torch.zeros(8, dtype=torch.bool)
    expected[2] = True
    assert bool(step.terminated.cpu()[2])
    assert not step.terminated.cpu()[~expected].any()
    assert int(environment.quarantined) == 1
    for tensor in (step.rewards, *step.observations.values()):
        assert torch.isfinite(tensor).all()


@pytest.mark.parametrize("device", DEVICES)
def test_overflow_is_counted(device: str) -> None:
    """Fault 3: too small a capacity is reported with a count; the default one never overflows."""
    small = build(device, "simulator.constraints=4", "simulator.contacts=1").environment
    roomy = build(device).environment
    for environment in (small, roomy):
        environment.reset(seed=0)
        for _ in range(4):
            environment.step(environment.observations["feedforward"])
    assert small.parts.simulator.report()["contact_or_constraint_overflows"] > 0
    assert roomy.parts.simulator.report() == {}


@pytest.mark.parametrize("device", DEVICES)
def test_resume_continues(device: str) -> None:
    """Fault 10: with deterministic=true, save and load in between changes no bit."""
    overrides = [
        *TASK, "simulator=mujoco_warp", f"device={device}", "num_worlds=8",
        "simulator.deterministic=true", "learner.rollout_steps=4",
    ]  # fmt: skip

    def train(iterations: int, training: Training) -> Training:
        for _ in range(iterations):
            training.iterate()
        return training

    straight = train(4, Training(load_experiment(overrides)))
    first = train(2, Training(load_experiment(overrides)))
    second = Training(load_experiment(overrides))
    second.load_state_dict(first.state_dict())
    train(2, second)
    for name, value in straight.policy.state_dict().items():
        assert torch.equal(value, second.policy.state_dict()[name]), name


@pytest.mark.gpu
def test_too_many_worlds_are_refused_before_allocating() -> None:
    with pytest.raises(ConfigError, match=r"About \d+ worlds fit"):
        build("cuda", worlds=50_000_000)


def test_without_a_gpu_one_line_says_what_is_missing() -> None:
    if torch.cuda.is_available():
        pytest.skip("this machine has a GPU")
    command = [
        sys.executable,
        "-m",
        "understudy.command.cli",
        "train",
        *TASK,
        "simulator=mujoco_warp",
    ]
    done = subprocess.run(command, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 2
    assert done.stderr.strip().splitlines()[-1] == (
        "understudy: device=cuda, but torch sees no CUDA GPU here. Use device=cpu."
    )


@pytest.mark.gpu
def test_nothing_goes_to_the_host_inside_a_rollout() -> None:
    """torch raises at any operation that waits for the device."""
    training = Training(load_experiment([*TASK, "simulator=mujoco_warp", "num_worlds=64"]))
    training.environment.reset()
    training.collector.collect(2)
    torch.cuda.synchronize()
    torch.cuda.set_sync_debug_mode("error")
    try:
        training.collector.collect(4)
    finally:
        torch.cuda.set_sync_debug_mode("default")


@pytest.mark.gpu
def test_an_update_waits_for_the_device_once() -> None:
    training = Training(load_experiment([*TASK, "simulator=mujoco_warp", "num_worlds=64"]))
    training.environment.reset()
    rollout = training.collector.collect(training.learner.rollout_steps)
    training.learner.update(rollout)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        torch.cuda.set_sync_debug_mode("warn")
        try:
            training.learner.update(rollout)
        finally:
            torch.cuda.set_sync_debug_mode("default")
    waits = [str(w.message) for w in caught if "synchronizing" in str(w.message)]
    # the sums of the metrics, the count of bad steps, and the explained variance, at the end
    assert len(waits) <= 3, waits


@pytest.mark.parametrize("device", DEVICES)
@pytest.mark.parametrize("cache", ["empty", "not writable"])
def test_cold_start(device: str, cache: str, tmp_path: Path) -> None:
    """Fault 30: with an empty kernel cache, and with one that cannot be written, the first step
    comes within a bound; the second says that the next start will be as slow."""
    folder = tmp_path / "kernels" if cache == "empty" else Path("/proc/no-such-cache")
    overrides = [*TASK, "simulator=mujoco_warp", f"device={device}", "num_worlds=8"]
    code = f"""
from understudy.setup.building import build_environment
from understudy.setup.config import load_experiment
environment = build_environment(load_experiment({overrides!r})).environment
environment.reset(seed=0)
environment.step(environment.observations["feedforward"])
print("stepped")
"""
    done = subprocess.run(
        [sys.executable, "-c", code], capture_output=True, text=True, check=False,
        timeout=240, env={**os.environ, "WARP_CACHE_PATH": str(folder)},
    )  # fmt: skip
    assert done.stdout.splitlines()[-1:] == ["stepped"], done.stderr
    assert ("No kernel cache to write" in done.stderr) == (cache != "empty")
