"""Fault 26, in part: advantages and returns equal a slow, obvious reference."""

from __future__ import annotations

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy_networks.returns import lambda_advantages

T, N = 7, 5


def slow(
    rewards: list, values: list, final: list, ended: list, last: float, gamma: float, lam: float
) -> list:
    """One world: at each step, the exponentially weighted mean of all n-step estimates."""
    result = []
    for t in range(T):
        end = next((i for i in range(t, T) if ended[i]), T - 1)  # the last step that counts
        estimates = []
        for n in range(1, end - t + 2):
            following = t + n
            if following <= end:  # noqa: SIM108
                tail = values[following]
            else:
                tail = final[end] if ended[end] else last
            estimates.append(
                sum(gamma**k * rewards[t + k] for k in range(n)) + gamma**n * tail - values[t]
            )
        weights = [(1 - lam) * lam**k for k in range(len(estimates) - 1)] + [
            lam ** (len(estimates) - 1)
        ]
        result.append(sum(w * e for w, e in zip(weights, estimates, strict=True)))
    return result


@settings(max_examples=40, deadline=None)
@given(
    seed=st.integers(0, 10**6), gamma=st.floats(0, 1), lam=st.floats(0, 1), often=st.floats(0, 1)
)
def test_equals_a_slow_reference(seed: int, gamma: float, lam: float, often: float) -> None:
    generator = torch.Generator().manual_seed(seed)
    rewards, values, final = torch.randn(3, T, N, generator=generator, dtype=torch.float64)
    last = torch.randn(N, generator=generator, dtype=torch.float64)
    ended = torch.rand(T, N, generator=generator) < often
    truncated = torch.rand(T, N, generator=generator) < 0.5
    final = torch.where(truncated, final, 0.0)  # nothing follows a terminal step
    following = torch.cat([values[1:], last.unsqueeze(0)])
    found = lambda_advantages(
        rewards,
        values,
        torch.where(ended, final, following),
        (~ended).double(),
        gamma=gamma,
        lam=lam,
    )
    for i in range(N):
        columns = [x[:, i].tolist() for x in (rewards, values, final, ended)]
        expected = slow(*columns, float(last[i]), gamma, lam)
        assert found[:, i].tolist() == pytest.approx(expected, abs=1e-9)


def test_known_values() -> None:
    ones, zeros = torch.ones(3, 1), torch.zeros(3, 1)
    assert lambda_advantages(ones, zeros, zeros, ones, gamma=0.5, lam=1.0).flatten().tolist() == [
        1.75,
        1.5,
        1.0,
    ]
    assert lambda_advantages(ones, zeros, zeros, ones, gamma=0.5, lam=0.0).flatten().tolist() == [
        1.0,
        1.0,
        1.0,
    ]
    assert lambda_advantages(ones, zeros, zeros, zeros, gamma=0.5, lam=1.0).flatten().tolist() == [
        1.0,
        1.0,
        1.0,
    ]
