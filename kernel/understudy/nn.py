"""The few network parts that policies share: an MLP, a running normaliser, a Gaussian."""

from __future__ import annotations

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass

import torch
from torch import Tensor, nn

from understudy import distributed
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task.interfaces import Distribution


def mlp(
    sizes: Sequence[int], *, activation: type[nn.Module] = nn.ReLU, final_scale: float = 1.0
) -> nn.Sequential:
    """Linear layers of `sizes` with `activation` between them; the last one's weights are scaled."""
    layers: list[nn.Module] = []
    for i, (inputs, outputs) in enumerate(itertools.pairwise(sizes)):
        linear = nn.Linear(inputs, outputs)
        last = i == len(sizes) - 2
        nn.init.orthogonal_(linear.weight, final_scale if last else math.sqrt(2.0))
        nn.init.zeros_(linear.bias)
        layers.append(linear)
        if not last:
            layers.append(activation())
    return nn.Sequential(*layers)


class RunningNormaliser(nn.Module):
    """Normalises by the running mean and variance of everything observed (Chan et al. 1979).

    Statistics are float64, so 1e9 samples and constant or huge inputs stay exact enough; the count
    saturates at `horizon` samples, after which old samples fade.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor

    def __init__(self, size: int, *, clip: float = 5.0, horizon: float = 1e8) -> None:
        super().__init__()
        self.clip, self.horizon = clip, horizon
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))

    @torch.no_grad()
    def observe(self, x: Tensor) -> None:
        """Digest samples `x` (…, D)."""
        count, mean, variance = distributed.moments(x.reshape(-1, x.shape[-1]).double())
        total = self.count + count
        delta = mean - self.mean
        share = count / total
        self.variance.copy_(
            self.variance * (1 - share) + variance * share + delta.square() * share * (1 - share)
        )
        self.mean.add_(delta * share)
        self.count.copy_(total.clamp(max=self.horizon))

    def forward(self, x: Tensor) -> Tensor:
        mean, scale = self.mean.float(), torch.rsqrt(self.variance + 1e-4).float()
        return ((x - mean) * scale).clamp(-self.clip, self.clip)


@dataclass(frozen=True)
class DiagonalGaussian(Distribution):
    """Independent normals with `mean` (…, A) and standard deviation `std` (A,)."""

    mean: Tensor
    std: Tensor

    def sample(self, streams: WorldStreams) -> Tensor:
        return self.mean + self.std * streams.normal(self.mean.shape[-1])

    def mode(self) -> Tensor:
        return self.mean

    def log_prob(self, action: Tensor) -> Tensor:
        z = (action - self.mean) / self.std
        constant = self.std.log().sum() + 0.5 * math.log(2 * math.pi) * self.std.shape[-1]
        return -0.5 * z.square().sum(-1) - constant

    def entropy(self) -> Tensor:
        constant = 0.5 * (1.0 + math.log(2 * math.pi))
        return (self.std.log() + constant).sum(-1).expand(self.mean.shape[:-1])


@dataclass(frozen=True)
class Schedule:
    """A value that goes linearly from `start` to `end` over `samples` training samples."""

    start: float
    end: float
    samples: int = 1_000_000

    def __post_init__(self) -> None:
        check_range(self, "samples", least=1)

    def at(self, samples: int) -> float:
        share = min(1.0, samples / self.samples)
        return self.start + (self.end - self.start) * share
