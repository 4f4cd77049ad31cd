"""Values, advantages and value targets of a rollout."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from understudy.task import Rollout
from understudy_networks import averages
from understudy_reinforcement.policy import Policy

__all__ = ["digest", "explained_variance", "observations_of"]

_SEEN = "observations/"


def lambda_advantages(
    rewards: Tensor,
    values: Tensor,
    next_values: Tensor,
    continues: Tensor,
    *,
    gamma: float,
    lam: float,
) -> Tensor:
    """Generalised advantage estimates (Schulman et al. 2016, eq. 16), (T, N).

    Parameters
    ----------
    rewards, values : (T, N)
    next_values : (T, N)
        value of the state that followed each step: zero after a terminal one, the value of the last state
        after a truncation.
    continues : (T, N) float
        1 where the next row belongs to the same episode, else 0.

    ``values + lambda_advantages(…)`` is the TD(lambda) return.
    """
    advantages = torch.empty_like(rewards)
    deltas = rewards + gamma * next_values - values
    decay = gamma * lam * continues
    running = torch.zeros_like(rewards[0])
    for t in range(rewards.shape[0] - 1, -1, -1):
        running = torch.addcmul(deltas[t], decay[t], running, out=advantages[t])
    return advantages


@torch.no_grad()
def digest(
    rollout: Rollout, policy: Policy, gamma: float, gae_lambda: float, td_lambda: float
) -> dict[str, Tensor]:
    """Set the rollout's values and TD(lambda) returns, and make one batch of its B = T·N steps.

    Returns
    -------
    dict
        ``observations/NAME`` (B, …), ``actions`` (B, A), ``log_probs``, ``returns`` and
        ``advantages`` (B,), the last with mean 0 and deviation 1 over all processes.
    """
    values = policy.value(rollout.observations)
    last = policy.value(rollout.last_observations)
    ended = rollout.ended
    following = torch.cat([values[1:], last.unsqueeze(0)])
    next_values = torch.where(ended, rollout.final_values, following)
    continues = (~ended).to(values.dtype)

    def estimate(lam: float) -> Tensor:
        return lambda_advantages(
            rollout.rewards, values, next_values, continues, gamma=gamma, lam=lam
        )

    advantages = estimate(gae_lambda)
    rollout.values = values
    rollout.returns = values + (advantages if td_lambda == gae_lambda else estimate(td_lambda))
    _, mean, variance = averages.moments(advantages.view(-1, 1))
    seen = {f"{_SEEN}{name}": value.flatten(0, 1) for name, value in rollout.observations.items()}
    return seen | {
        "actions": rollout.actions.flatten(0, 1),
        "log_probs": rollout.log_probs.flatten(),
        "returns": rollout.returns.flatten(),
        "advantages": (advantages.flatten() - mean) / (variance.sqrt() + 1e-5),
    }


def observations_of(batch: Mapping[str, Tensor]) -> dict[str, Tensor]:
    """The observations by name of a batch that :func:`digest` made, or of rows of it."""
    return {k.removeprefix(_SEEN): v for k, v in batch.items() if k.startswith(_SEEN)}


def explained_variance(rollout: Rollout) -> float:
    """1 - Var(returns - values) / Var(returns) of a digested rollout: 1 is a perfect critic."""
    assert rollout.returns is not None
    assert rollout.values is not None
    left = (rollout.returns - rollout.values).var() / (rollout.returns.var() + 1e-8)
    return float(1 - left)
