"""What learners make of a rollout."""

from __future__ import annotations

import pytest
import torch
from line_task import SIDE_AND_STEP, Line, line_context, make_policy

from understudy_networks.policies import MLPPolicy
from understudy_networks.returns import (
    digest,
    explained_variance,
    lambda_advantages,
    observations_of,
)

T, N = 12, 8


def test_digest() -> None:
    context = line_context(SIDE_AND_STEP, N)
    policy = make_policy(MLPPolicy, MLPPolicy.Options(hidden=(16,)), context)
    rollout = Line(context, policy).collect(T)
    assert rollout.truncated.any()
    batch = digest(rollout, policy, gamma=0.9, gae_lambda=0.8, td_lambda=0.7)
    assert {name: tuple(value.shape) for name, value in batch.items()} == {
        "observations/state": (T * N, 2), "actions": (T * N, 3), "log_probs": (T * N,),
        "returns": (T * N,), "advantages": (T * N,),
    }  # fmt: skip
    assert rollout.values is not None
    assert rollout.returns is not None
    values = policy.value(rollout.observations).detach()
    torch.testing.assert_close(rollout.values, values)
    ended = rollout.terminated | rollout.truncated
    after = torch.cat([values[1:], policy.value(rollout.last_observations).detach()[None]])
    known = (rollout.rewards, values, torch.where(ended, rollout.final_values, after))
    gae, td = (lambda_advantages(*known, (~ended).float(), gamma=0.9, lam=x) for x in (0.8, 0.7))
    torch.testing.assert_close(rollout.returns, values + td)
    torch.testing.assert_close(batch["returns"].view(T, N), rollout.returns)
    normalised = (gae - gae.mean()) / (gae.std(correction=0) + 1e-5)
    torch.testing.assert_close(batch["advantages"].view(T, N), normalised, atol=1e-5, rtol=1e-4)
    seen = observations_of(batch)
    assert torch.equal(seen["state"].view(T, N, 2), rollout.observations["state"])
    torch.testing.assert_close(
        policy.distribution(seen).log_prob(batch["actions"]), batch["log_probs"]
    )


def test_explained_variance() -> None:
    context = line_context(worlds=N)
    policy = make_policy(MLPPolicy, MLPPolicy.Options(hidden=(16,)), context)
    rollout = Line(context, policy).collect(T)
    chance = torch.Generator().manual_seed(0)
    rollout.returns = torch.randn(T, N, generator=chance)
    rollout.values = rollout.returns.clone()
    assert explained_variance(rollout) == pytest.approx(1.0)
    rollout.values = torch.full((T, N), 7.0)
    assert explained_variance(rollout) == pytest.approx(0.0, abs=1e-6)
    rollout.values = 0.5 * rollout.returns
    assert explained_variance(rollout) == pytest.approx(0.75)
