"""Acting by decoded poses on a GPU: steps are captured, and targets are those of a CPU."""

from __future__ import annotations

import warnings
from pathlib import Path

import pytest
import torch

pytest.importorskip(
    "mujoco_warp", reason="MuJoCo Warp is not installed (pip install 'understudy[gpu]')"
)

from understudy.command.cli import main
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_reinforcement.job import Reinforcement

pytestmark = pytest.mark.gpu

SMALL = (
    "task=spacetime/walk",
    "policy=mlp",
    "learner=ppo",
    "learner.rollout_steps=16",
    "num_worlds=256",
    "evaluation.episodes=16",
    "evaluation.final_episodes=16",
    "evaluation.seconds=1.0",
    "actuation=pose_vae/offset",
    "actuation.offset_limit=20.0",
    "+reward.terms.natural={name: pose_vae/naturalness}",
)


@pytest.fixture(scope="module")
def poses(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """An auto-encoder that was trained on the GPU."""
    folder = tmp_path_factory.mktemp("poses") / "run"
    quick = ["experiment=pose_vae/generated", "job.clips=[walk]", "budget.samples=20000"]
    assert main(["train", *quick, "device=cuda", f"run.dir={folder}"]) == 0
    return folder


def test_trains_and_evaluates_recorded(poses: Path) -> None:
    """With the distance to known poses as a measure."""
    chosen = [f"actuation.run={poses}", "simulator=mujoco_warp", "device=cuda"]
    chosen += [f"+measure.unusual={{name: pose_vae/distance, run: '{poses}', reduce: mean}}"]
    with warnings.catch_warnings():
        warnings.filterwarnings("error", message="Steps cannot be captured")
        training = Training(load_experiment([*SMALL, *chosen])).prepare()
        for _ in range(6):
            row = training.iterate()
            assert row["skipped_steps"] == 0
        found = training.job.evaluate("test", 16)
    training.close()
    assert 0 < found.measures["unusual"].mean < 180


def test_targets_as_on_a_cpu(poses: Path) -> None:
    stream = torch.Generator().manual_seed(0)
    found = {}
    for device, simulator in (("cpu", "mujoco"), ("cuda", "mujoco_warp")):
        chosen = [f"actuation.run={poses}", f"simulator={simulator}", f"device={device}"]
        job = Training(load_experiment([*SMALL, *chosen])).prepare().job
        assert isinstance(job, Reinforcement)
        actuation = job.environment.parts.actuation.part
        action = torch.randn(256, actuation.action_space.size, generator=stream.manual_seed(0))
        found[device] = actuation.control(action.to(device)).cpu()
        job.close()
    torch.testing.assert_close(found["cuda"], found["cpu"], atol=1e-3, rtol=0)
