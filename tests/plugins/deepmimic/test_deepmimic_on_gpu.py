"""The walk on a GPU: its steps are captured, its evaluations too, and what they give is what a CPU gives."""

from __future__ import annotations

import warnings

import pytest
import torch

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy.running.training import Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_reinforcement.job import Reinforcement

pytestmark = pytest.mark.gpu

SMALL = (
    "experiment=deepmimic/walk_gpu", "num_worlds=256", "learner.batch_size=256",
    "evaluation.episodes=16", "evaluation.final_episodes=16", "difficulty=0.1",
)  # fmt: skip


@pytest.mark.parametrize("more", [(), ("learner.epochs=3",), ("curriculum=deepmimic/annealed",)])
def test_trains_and_evaluates_recorded(more: tuple[str, ...]) -> None:
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="Steps cannot be captured")
        training = Training(load_experiment([*SMALL, *more])).prepare()
        for _ in range(8):
            row = training.iterate()
            assert row["skipped_steps"] == 0
            assert 0 < row["reward"] < 1
        found = training.job.evaluate("test", 16)
        assert isinstance(training.job, Reinforcement)
        again = training.job.evaluate("test", 16)
    training.close()
    for evaluation in (found, again):
        assert evaluation.objective_value == pytest.approx(
            evaluation.measures["return"].mean / 87, rel=1e-5
        )
        assert evaluation.mean_episode_seconds is not None
        assert evaluation.mean_episode_seconds <= 2.9 + 1e-4


def test_rewards_as_on_a_cpu() -> None:
    found = {}
    for device, simulator in (("cpu", "mujoco"), ("cuda", "mujoco_warp")):
        chosen = ["experiment=deepmimic/walk", f"simulator={simulator}", f"device={device}"]
        environment = build_environment(load_experiment([*chosen, "num_worlds=32"])).environment
        environment.reset(seed=3)
        rewards = []
        for _ in range(3):
            target = environment.table["reference_joint_targets"].clone()
            rewards.append(environment.step(target).rewards.clone().cpu())
        found[device] = torch.stack(rewards)
        environment.close()
    torch.testing.assert_close(found["cuda"], found["cpu"], atol=0.02, rtol=0)
