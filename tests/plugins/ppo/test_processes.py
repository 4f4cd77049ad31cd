"""Two processes with half of the worlds each make the step of one process with all of them."""

from __future__ import annotations

import dataclasses
from pathlib import Path
from typing import Any

import pytest
import torch
from commands import forked_together
from line_task import STEP, Line, line_context, make_policy
from torch import Tensor

from understudy.task import Rollout
from understudy_networks.nn import Schedule
from understudy_networks.policies import MLPPolicy
from understudy_ppo.learner import PPO
from understudy_ppo.losses import KLPenalty

STEPS, WORLDS = 8, 16

CHILD = """
import os, sys, torch, torch.distributed as dist
here, folder, case = sys.argv[1:]
sys.path.append(here)
import test_processes as t
rank = int(os.environ["RANK"])
torch.set_num_threads(1)
dist.init_process_group("gloo", init_method=f"file://{folder}/meet", rank=rank, world_size=2)
whole = torch.load(f"{folder}/rollout.pt", weights_only=False)
torch.save(t.after(t.half(whole, rank), t.WORLDS // 2, case), f"{folder}/{rank}.pt")
dist.destroy_process_group()
"""

OPTIONS: dict[str, dict[str, Any]] = {
    "adam": {},
    "sgd": {"optimiser": "sgd", "momentum": 0.9, "weight_decay": 1e-2, "max_gradient_norm": 0.1},
    "penalty": {"clip": None, "kl_penalty": KLPenalty()},
}


def made(worlds: int) -> Any:
    options = MLPPolicy.Options(hidden=(8,), noise=Schedule(0.5, 0.5), final_scale=0.5)
    return make_policy(MLPPolicy, options, line_context(STEP, worlds))


def half(whole: Rollout, rank: int) -> Rollout:
    """The worlds of process `rank`."""

    def part(value: Any, name: str) -> Any:
        if isinstance(value, Tensor):
            return value.chunk(2, 0 if name == "last_observations" else 1)[rank].contiguous()
        return {k: part(v, name) for k, v in value.items()} if isinstance(value, dict) else value

    fields = dataclasses.fields(whole)
    return Rollout(**{f.name: part(getattr(whole, f.name), f.name) for f in fields})


def after(given: Rollout, worlds: int, case: str) -> dict[str, Any]:
    """Weights and metrics after three updates of one step each."""
    policy = made(worlds)
    options = PPO.Options(rollout_steps=STEPS, epochs=3, minibatches=1, **OPTIONS[case])
    metrics = PPO(options, line_context(STEP, worlds), policy).update(given)
    return {"weights": dict(policy.named_parameters()), "metrics": metrics}


@pytest.mark.parametrize("case", OPTIONS)
def test_two_processes_are_one(tmp_path: Path, case: str) -> None:
    whole = Line(line_context(STEP, WORLDS), made(WORLDS)).collect(STEPS)
    torch.save(whole, tmp_path / "rollout.pt")
    alone = [{"GLOO_SOCKET_IFNAME": "lo", "RANK": str(rank)} for rank in range(2)]
    here = str(Path(__file__).parent)
    ends = forked_together(CHILD, here, str(tmp_path), case, cwd=tmp_path, environments=alone)
    assert [end.returncode for end in ends] == [0, 0], [end.stderr for end in ends]
    one = after(whole, WORLDS, case)
    both = [torch.load(tmp_path / f"{rank}.pt", weights_only=False) for rank in range(2)]
    for name, value in one["weights"].items():
        torch.testing.assert_close(both[0]["weights"][name], value, rtol=1e-4, atol=1e-6)
        assert torch.equal(both[0]["weights"][name], both[1]["weights"][name])
    for name in ("actor_loss", "value_loss", "kl", "clipped"):
        expected = pytest.approx(one["metrics"][name], rel=1e-3, abs=1e-6)
        assert both[0]["metrics"][name] == both[1]["metrics"][name] == expected
