"""Advantages and value targets from rollouts."""

from __future__ import annotations

import torch
from torch import Tensor


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
        value of the state that followed each step: zero after a terminal one, the value of the cut
        state after a truncation.
    continues : (T, N) float
        1 where the next row belongs to the same episode, else 0.

    ``values + lambda_advantages(…)`` is the TD(lambda) return.
    """
    advantages = torch.empty_like(rewards)
    deltas = rewards + gamma * next_values - values
    running = torch.zeros_like(rewards[0])
    for t in range(rewards.shape[0] - 1, -1, -1):
        running = deltas[t] + gamma * lam * continues[t] * running
        advantages[t] = running
    return advantages
