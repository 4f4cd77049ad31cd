from __future__ import annotations

import math

import pytest
import torch

from understudy.nn import DiagonalGaussian, RunningNormaliser, Schedule, mlp
from understudy.random import WorldStreams


def test_mlp() -> None:
    net = mlp([4, 8, 3], final_scale=0.01)
    assert [type(m).__name__ for m in net] == ["Linear", "ReLU", "Linear"]
    assert float(
        net[0].weight.detach().T.matmul(net[0].weight.detach()).diagonal().mean()
    ) == pytest.approx(2.0)  # type: ignore[operator]
    assert float(net[2].weight.abs().max()) <= 0.01  # type: ignore[union-attr]
    assert not net[0].bias.any()  # type: ignore[union-attr]


def test_normaliser_equals_numpy_statistics() -> None:
    x = (
        torch.randn(1000, 3, generator=torch.Generator().manual_seed(0))
        * torch.tensor([1.0, 20, 0.3])
        + 5
    )
    normaliser = RunningNormaliser(3)
    for part in x.split([1, 99, 400, 500]):
        normaliser.observe(part.view(1, -1, 3))
    assert torch.allclose(normaliser.mean, x.double().mean(0))
    assert torch.allclose(normaliser.variance, x.double().var(0, correction=0))
    assert float(normaliser.count) == 1000
    out = normaliser(x)
    assert out.abs().max() <= 5
    assert out.dtype == torch.float32


def test_normaliser_horizon_lets_old_samples_fade() -> None:
    normaliser = RunningNormaliser(1, horizon=100)
    normaliser.observe(torch.zeros(100_000, 1))
    for _ in range(100):
        normaliser.observe(torch.ones(10, 1))
    assert float(normaliser.mean) > 0.99


def test_gaussian() -> None:
    mean, std = torch.tensor([[0.5, -1.0]]).repeat(4, 1), torch.tensor([0.5, 2.0])
    distribution = DiagonalGaussian(mean, std)
    reference = torch.distributions.Independent(torch.distributions.Normal(mean, std), 1)
    action = torch.randn(4, 2, generator=torch.Generator().manual_seed(0))
    assert torch.allclose(distribution.log_prob(action), reference.log_prob(action))
    assert torch.allclose(distribution.entropy(), reference.entropy())
    assert torch.equal(distribution.mode(), mean)
    many = DiagonalGaussian(mean[:1].repeat(100_000, 1), std).sample(
        WorldStreams(0, "a", 100_000, "cpu")
    )
    assert torch.allclose(many.mean(0), mean[0], atol=0.03)
    assert torch.allclose(many.std(0), std, rtol=0.01)


def test_schedule() -> None:
    schedule = Schedule(1.0, 0.0, 100)
    assert [schedule.at(n) for n in (0, 50, 100, 10**9)] == [1.0, 0.5, 0.0, 0.0]
    with pytest.raises(ValueError, match="samples=0"):
        Schedule(1.0, 0.0, 0)
    assert math.isclose(Schedule(0.1, 0.1).at(7), 0.1)
