"""Two processes that imagine together, each with its own worlds and replay, have one policy and one model."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import torch
from worlds import child_environment

CHILD = """
import sys, torch, torch.distributed as dist
from imagined_walk import WALK
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import load
from understudy_reinforcement.job import Reinforcement
rank, folder = int(sys.argv[1]), sys.argv[2]
torch.set_num_threads(1)
dist.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
job = Reinforcement(None, load_experiment([*WALK], load()))
job.prepare()
samples = 0
for _ in range(3):
    row = job.iterate(samples)
    samples += int(row["consumed"])
learner = job.learner
torch.save({
    "policy": dict(job.policy.named_parameters()),
    "model": dict(learner.model.state_dict()),
    "own": learner.replay.state_dict()["rows"]["inputs"],
    "samples": samples, "counted": learner._samples, "row": row,
}, f"{folder}/{rank}.pt")
job.close()
dist.destroy_process_group()
"""


@pytest.mark.slow
def test_two_processes_have_one_policy_and_one_model(tmp_path: Path) -> None:
    environment = child_environment(GLOO_SOCKET_IFNAME="lo")
    environment["PYTHONPATH"] += f":{Path(__file__).parent}"
    children = [
        subprocess.Popen([sys.executable, "-c", CHILD, str(rank), str(tmp_path)], env=environment)
        for rank in range(2)
    ]
    try:
        assert [child.wait(timeout=240) for child in children] == [0, 0]
    finally:
        for child in children:
            child.kill()
    one, other = (torch.load(tmp_path / f"{rank}.pt", weights_only=False) for rank in range(2))
    for part in ("policy", "model"):
        assert one[part].keys() == other[part].keys()
        for name, value in one[part].items():
            assert torch.equal(value, other[part][name]), name
    assert not torch.equal(one["own"], other["own"])
    # What waits for samples or shrinks with them goes by those of both.
    assert one["counted"] == one["samples"] == 3 * 2 * 4 * 8
    assert one["row"]["model_loss"] == other["row"]["model_loss"]
