"""On a GPU: captured optimiser steps do what steps that are not captured do."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest
import torch
from line_task import STEP, Line, line_context, make_policy
from torch import Tensor

from understudy.task import Rollout
from understudy_networks.graphs import Captured
from understudy_networks.nn import Schedule
from understudy_networks.policies import MLPPolicy
from understudy_ppo.learner import PPO
from understudy_ppo.losses import KLPenalty

STEPS = 16


def moved(value: Any, device: torch.device) -> Any:
    if isinstance(value, Tensor):
        return value.to(device)
    return {k: v.to(device) for k, v in value.items()} if isinstance(value, dict) else value


def on(rollout: Rollout, device: torch.device) -> Rollout:
    fields = dataclasses.fields(rollout)
    return Rollout(**{f.name: moved(getattr(rollout, f.name), device) for f in fields})


def weights_after(options: dict[str, Any], rollouts: list[Rollout]) -> dict[str, Tensor]:
    device = rollouts[0].rewards.device
    context = dataclasses.replace(line_context(STEP), device=device)
    made = MLPPolicy.Options(hidden=(32,), noise=Schedule(0.5, 0.5))
    policy = make_policy(MLPPolicy, made, context).to(device)
    learner = PPO(PPO.Options(rollout_steps=STEPS, **options), context, policy)
    for rollout in rollouts:
        assert learner.update(rollout)["skipped_steps"] == 0
    return {k: v.detach().clone() for k, v in policy.named_parameters()}


@pytest.mark.parametrize(
    "options",
    [
        pytest.param({}, id="adam"),
        pytest.param({"optimiser": "sgd", "momentum": 0.9, "weight_decay": 1e-3}, id="sgd"),
        pytest.param({"clip": None, "kl_penalty": KLPenalty(), "target_kl": 0.01}, id="penalty"),
        pytest.param({"minibatches": None, "batch_size": 100}, id="batch-size"),
        pytest.param({"precision": "bfloat16"}, id="bfloat16"),
        pytest.param({"critic_first": 2}, id="critic-first"),
        pytest.param({"minibatches": 64}, id="two-graphs-an-epoch"),
        pytest.param({"minibatches": 37}, id="a-graph-a-step"),
    ],
)
@pytest.mark.parametrize("kind", ["cpu", pytest.param("cuda", marks=pytest.mark.gpu)])
def test_captured_steps_are_the_same_steps(
    kind: str, options: dict[str, Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    if kind == "cuda" and not torch.cuda.is_available():
        pytest.skip("no CUDA GPU")
    context = line_context(STEP)
    policy = make_policy(MLPPolicy, MLPPolicy.Options(hidden=(32,)), context)
    line, device = Line(context, policy), torch.device(kind)
    count = 3 if kind == "cuda" else 1  # where nothing is recorded, nothing warms up
    rollouts = [on(line.collect(STEPS), device) for _ in range(count)]
    recorded = weights_after(options, rollouts)
    monkeypatch.setattr(Captured, "_WARM_UP", 10**9)
    plain = weights_after(options, rollouts)
    for name, value in recorded.items():
        torch.testing.assert_close(value, plain[name], rtol=1e-4, atol=1e-5)
