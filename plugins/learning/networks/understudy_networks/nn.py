"""The few network parts that policies share: networks, a running normaliser, action distributions."""

from __future__ import annotations

import contextlib
import functools
import itertools
import math
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Literal, TypeVar

import torch
from torch import Tensor, nn

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy.random import WorldStreams
from understudy.task import ActionSpace, Box
from understudy_networks import averages
from understudy_networks.convolution import Convolution
from understudy_reinforcement.policy import Distribution

__all__ = ["DiagonalGaussian", "Precision", "mlp", "set_precision"]

_Layer = TypeVar("_Layer", nn.Linear, Convolution)


Precision = Literal["float32", "tf32", "bfloat16"]
"""Number format of matrix products; tf32 is NVIDIA's, and float32 on CPUs."""


#: The most weights of a network.
LARGEST = 2**27
#: Numbers of a layer's weight from which oneDNN's way of keeping tensors is worth the change.
_WIDE = 2**18


@functools.cache
def _onednn_is_faster() -> bool:
    """Whether oneDNN's float32 products are faster than MKL's, which uses AVX-512 on Intel only."""
    if not (torch.backends.mkldnn.is_available() and torch.backends.mkl.is_available()):
        return False
    known = getattr(torch.cpu, "get_capabilities", dict)()  # newer than the oldest torch we run on
    return "AMD" in known.get("cpu_name", "") and known.get("avx512_f", False)


class Network(nn.Sequential):
    """Layers in a row that may compute in bfloat16: all but the last one, whose products stay in
    the weights' own format because means and values are differences of theirs.

    In float32 wide layers with ReLUs go through oneDNN on CPUs where it is faster; it has no second
    derivatives.
    """

    precision: Precision = "float32"
    twice: bool = False  #: whether second derivatives are wanted

    @functools.cached_property
    def _suits_onednn(self) -> bool:
        *hidden, _ = self
        linear = [layer.weight for layer in hidden if isinstance(layer, nn.Linear)]
        rest = [layer for layer in hidden if not isinstance(layer, nn.Linear)]
        wide = any(weight.numel() >= _WIDE for weight in linear)
        return wide and all(isinstance(layer, nn.ReLU) for layer in rest)

    def _through_onednn(self, x: Tensor) -> bool:
        plain = x.device.type == "cpu" and x.dtype == torch.float32 and self.precision != "bfloat16"
        # Its tensors can be neither compiled nor exported.
        plain = plain and not torch.compiler.is_compiling()
        differentiable = not (self.twice and torch.is_grad_enabled())
        return plain and differentiable and self._suits_onednn and _onednn_is_faster()

    def forward(self, input: Tensor) -> Tensor:
        *hidden, last = self
        if self._through_onednn(input):
            x = input.to_mkldnn()
            for layer in hidden:
                x = layer(x)
            return last(x.to_dense())
        x, device, half = input, input.device.type, self.precision == "bfloat16"
        # Entering it takes a tenth of a small network's time; without half it is there to end another's.
        needed = half or torch.is_autocast_enabled(device)
        with (
            torch.autocast(device, torch.bfloat16, enabled=half)
            if needed
            else contextlib.nullcontext()
        ):
            for layer in hidden:
                x = layer(x)
        return last(x.to(input.dtype))


def set_precision(policy: nn.Module, precision: Precision, *, twice: bool = False) -> None:
    """Let the networks of `policy` compute in `precision`, acting and learning alike; `twice` if second
    derivatives are wanted.

    TF32 is the process's setting (which environments leave out, decision 8), bfloat16 that of every
    :class:`Network` in the policy.

    Raises
    ------
    ConfigError
        if bfloat16 is asked for and the policy has no network that knows it.
    """
    networks = [module for module in policy.modules() if isinstance(module, Network)]
    if precision == "bfloat16" and not networks:
        raise ConfigError(
            f"This policy ({type(policy).__name__}) has no network that computes in bfloat16. "
            "Use learner.precision=float32 or another policy."
        )
    torch.backends.cuda.matmul.allow_tf32 = precision == "tf32"
    torch.backends.cudnn.allow_tf32 = precision == "tf32"
    for network in networks:
        network.precision, network.twice = precision, twice


def scaled(linear: _Layer, scale: float = math.sqrt(2.0)) -> _Layer:
    """The layer with orthogonal weights of `scale` and no bias; sqrt(2) keeps a ReLU's variance."""
    nn.init.orthogonal_(linear.weight, scale)
    if linear.bias is not None:
        nn.init.zeros_(linear.bias)
    return linear


def relu() -> nn.Module:
    """In place: nobody else needs its input, and small layers are limited by memory."""
    return nn.ReLU(inplace=True)


def mlp(
    sizes: Sequence[int],
    *,
    activation: Callable[[], nn.Module] = relu,
    final_scale: float = 1.0,
) -> Network:
    """Linear layers of `sizes` with `activation` between them; the last one's weights are scaled."""
    *hidden, last = itertools.pairwise(sizes)
    if sum(a * b for a, b in (*hidden, last)) > LARGEST:  # before there is memory for it
        raise ConfigError(
            f"A network of layers of {list(sizes)} is too large: it would have more than {LARGEST} weights."
        )
    layers = [part for pair in hidden for part in (scaled(nn.Linear(*pair)), activation())]
    return Network(*layers, scaled(nn.Linear(*last), final_scale))


class RunningNormaliser(nn.Module):
    """Normalises by the running mean and variance of everything observed (Chan et al. 1979).

    Statistics are float64, so 1e9 samples and constant or huge inputs stay exact enough; the count
    saturates at `horizon` samples, after which old samples fade.
    """

    mean: Tensor
    variance: Tensor
    count: Tensor
    _centre: Tensor
    _scale: Tensor

    def __init__(self, size: int, *, clip: float = 5.0, horizon: float = 1e8) -> None:
        super().__init__()
        self.clip, self.horizon = clip, horizon
        self.register_buffer("mean", torch.zeros(size, dtype=torch.float64))
        self.register_buffer("variance", torch.ones(size, dtype=torch.float64))
        self.register_buffer("count", torch.zeros((), dtype=torch.float64))
        self.register_buffer("_centre", torch.zeros(size), persistent=False)
        self.register_buffer("_scale", torch.ones(size), persistent=False)
        self._prepare()

    def _prepare(self) -> None:
        """Compute what each pass needs of the statistics, in its number format."""
        self._centre.copy_(self.mean)
        self._scale.copy_(torch.rsqrt(self.variance + 1e-4))

    def _load_from_state_dict(self, *args: Any, **kwargs: Any) -> None:
        super()._load_from_state_dict(*args, **kwargs)
        if not all(bool((value >= 0).all()) for value in (self.variance, self.count)):
            raise ValueError("a normaliser's variance or count is below 0, which no samples have")
        self._prepare()

    @torch.no_grad()
    def observe(self, x: Tensor) -> None:
        """Digest samples `x` (…, D)."""
        count, mean, variance = averages.moments(x.reshape(-1, x.shape[-1]).double())
        total = self.count + count
        delta = mean - self.mean
        share = count / total
        self.variance.copy_(
            self.variance * (1 - share) + variance * share + delta.square() * share * (1 - share)
        )
        self.mean.add_(delta * share)
        self.count.copy_(total.clamp(max=self.horizon))
        self._prepare()

    def forward(self, x: Tensor) -> Tensor:
        return ((x - self._centre) * self._scale).clamp(-self.clip, self.clip)


def squared_difference(a: Tensor, b: Tensor) -> Tensor:
    """(a - b)², which torch differentiates with one operation instead of four."""
    return nn.functional.mse_loss(a, b, reduction="none")


@dataclass(frozen=True)
class DiagonalGaussian(Distribution):
    """Independent normals with `mean` (…, A) and standard deviation `std`, (A,) or (…, A)."""

    mean: Tensor
    std: Tensor

    def sample(self, streams: WorldStreams) -> Tensor:
        return self.mean + self.std * streams.normal(self.mean.shape[-1])

    def mode(self) -> Tensor:
        return self.mean

    def log_prob(self, action: Tensor) -> Tensor:
        z_squared = squared_difference(self.mean, action) / self.std.square()
        peak = -0.5 * math.log(2 * math.pi) * self.std.shape[-1] - self.std.log().sum(-1)
        return torch.add(peak, z_squared.sum(-1), alpha=-0.5)

    def entropy(self) -> Tensor:
        constant = 0.5 * (1.0 + math.log(2 * math.pi))
        return (self.std.log() + constant).sum(-1).expand(self.mean.shape[:-1])

    def divergence(self, other: DiagonalGaussian) -> Tensor:
        ratio = (self.std / other.std).square()
        away = squared_difference(other.mean, self.mean) / other.std.square()
        return 0.5 * (away + (ratio - 1.0 - ratio.log())).sum(-1)

    def map(self, change: Callable[[Tensor], Tensor]) -> DiagonalGaussian:
        return DiagonalGaussian(change(self.mean), change(self.std))


@dataclass(frozen=True)
class Categorical(Distribution):
    """One of K options with unnormalised log-probabilities `logits` (…, K); its action is (…, 1)."""

    logits: Tensor

    def sample(self, streams: WorldStreams) -> Tensor:
        below = self.logits.softmax(-1).cumsum(-1) <= streams.uniform(1)
        most = self.logits.shape[-1] - 1  # where rounding leaves the sum below 1
        return below.sum(-1, keepdim=True).clamp(max=most).to(self.logits.dtype)

    def mode(self) -> Tensor:
        return self.logits.argmax(-1, keepdim=True).to(self.logits.dtype)

    def log_prob(self, action: Tensor) -> Tensor:
        return self.logits.log_softmax(-1).gather(-1, action.long()).squeeze(-1)

    def entropy(self) -> Tensor:
        log = self.logits.log_softmax(-1)
        return -(log.exp() * log).sum(-1)

    def divergence(self, other: Categorical) -> Tensor:
        log = self.logits.log_softmax(-1)
        return (log.exp() * (log - other.logits.log_softmax(-1))).sum(-1)

    def map(self, change: Callable[[Tensor], Tensor]) -> Categorical:
        return Categorical(change(self.logits))


@dataclass(frozen=True)
class Joint(Distribution):
    """Independent distributions side by side; `widths` are their numbers of columns."""

    parts: tuple[Distribution, ...]
    widths: tuple[int, ...]

    def _columns(self, action: Tensor) -> Iterator[tuple[Distribution, Tensor]]:
        return zip(self.parts, action.split(list(self.widths), dim=-1), strict=True)

    def sample(self, streams: WorldStreams) -> Tensor:
        return torch.cat([part.sample(streams) for part in self.parts], dim=-1)

    def mode(self) -> Tensor:
        return torch.cat([part.mode() for part in self.parts], dim=-1)

    def log_prob(self, action: Tensor) -> Tensor:
        return _total(part.log_prob(columns) for part, columns in self._columns(action))

    def entropy(self) -> Tensor:
        return _total(part.entropy() for part in self.parts)

    def divergence(self, other: Joint) -> Tensor:
        pairs = zip(self.parts, other.parts, strict=True)
        return _total(part.divergence(theirs) for part, theirs in pairs)

    def map(self, change: Callable[[Tensor], Tensor]) -> Joint:
        return Joint(tuple(part.map(change) for part in self.parts), self.widths)


def _total(values: Iterable[Tensor]) -> Tensor:
    return torch.stack(tuple(values)).sum(0)


def head_size(space: ActionSpace) -> int:
    """How many outputs of a network :func:`action_distribution` needs: the means of the boxes and
    the logits of the choices."""
    return sum(p.size if isinstance(p, Box) else p.count for p in space.parts.values())


def box_columns(space: ActionSpace) -> int:
    """How many columns of an action are real numbers."""
    return sum(part.size for part in space.parts.values() if isinstance(part, Box))


def action_distribution(space: ActionSpace, outputs: Tensor, std: Tensor) -> Distribution:
    """The distribution over `space` of a network's `outputs` (…, head_size), with the standard
    deviation `std` (box_columns,) of the boxes' numbers."""
    parts = tuple(space.parts.values())
    if len(parts) == 1 and isinstance(parts[0], Box):
        return DiagonalGaussian(outputs, std)
    pieces = outputs.split([p.size if isinstance(p, Box) else p.count for p in parts], dim=-1)
    found: list[Distribution] = []
    at = 0
    for part, piece in zip(parts, pieces, strict=True):
        if isinstance(part, Box):
            found.append(DiagonalGaussian(piece, std[at : at + part.size]))
            at += part.size
        else:
            found.append(Categorical(piece))
    return Joint(tuple(found), tuple(part.columns for part in parts))


@dataclass(frozen=True)
class Schedule:
    """A value that goes linearly from `start` to `end` over `samples` training samples."""

    start: float  #: the value at the beginning
    end: float  #: the value from ``samples`` on
    samples: int = 1_000_000  #: training samples until ``end``, from 1

    def __post_init__(self) -> None:
        check_range(self, "samples", least=1, most=2**53)
        check_range(self, "start", "end", least=-1e6)

    def at(self, samples: int) -> float:
        share = min(1.0, samples / self.samples)
        return self.start + (self.end - self.start) * share
