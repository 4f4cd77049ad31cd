"""Random streams that depend on nothing but (seed, name, world, draw).

Every consumer of randomness has a stream with a name of its own, so adding a consumer changes no
other. Each world has its own sequence, so the numbers of world *i* do not depend on how many worlds
there are. Draws hash a counter (SplitMix64's finaliser) on the device, without waiting for it. The
global random states of torch, NumPy and Python are never touched.
"""

from __future__ import annotations

import contextlib
import hashlib
import math
from collections.abc import Iterator

import torch
from torch import Tensor

from understudy import distributed

__all__ = ["WorldStreams", "derive_seed", "generator", "private_rng"]

#: 0x9E3779B97F4A7C15 as int64: 2^64 / golden ratio (Steele et al. 2014).
_GAMMA = -0x61C8864680B583EB
_MIX_1 = -0x40A7B892E31B1A47  # 0xBF58476D1CE4E5B9
_MIX_2 = -0x6B2FB644ECCEEE15  # 0x94D049BB133111EB


def _shift(x: Tensor, bits: int) -> Tensor:
    return (x >> bits) & ((1 << (64 - bits)) - 1)  # logical shift; torch's is arithmetic


def _mix(x: Tensor) -> Tensor:
    x = (x ^ _shift(x, 30)) * _MIX_1
    x = (x ^ _shift(x, 27)) * _MIX_2
    return x ^ _shift(x, 31)


def derive_seed(seed: int, name: str) -> int:
    """A 63-bit seed for the consumer `name`, independent of every other name's."""
    return int.from_bytes(hashlib.sha256(f"{seed}/{name}".encode()).digest()[:8], "little") >> 1


def generator(seed: int, name: str, device: torch.device | str = "cpu") -> torch.Generator:
    """The consumer's own generator, for draws that belong to no world (shuffles, weights)."""
    return torch.Generator(device).manual_seed(derive_seed(seed, name))


@contextlib.contextmanager
def private_rng(seed: int, name: str) -> Iterator[None]:
    """torch's CPU generator seeded for `name` inside, and as it was before outside.

    For library code that can only draw from the global generator (``nn.Linear``'s initialisation).
    """
    with torch.random.fork_rng(devices=[]):
        torch.default_generator.manual_seed(derive_seed(seed, name))
        yield


class WorldStreams:
    """Per-world random numbers on one device. State: each world's number of draws."""

    def __init__(self, seed: int, name: str, num_worlds: int, device: torch.device | str) -> None:
        self._counter = torch.zeros((num_worlds, 1), dtype=torch.int64, device=device)
        self._key = torch.empty_like(self._counter)
        self.restart(seed, name)

    def restart(self, seed: int, name: str) -> None:
        """Become the stream `name` of `seed`, at its beginning, in place."""
        world = torch.arange(len(self._key), dtype=torch.int64, device=self._key.device)
        world += distributed.rank() * len(self._key)
        self._key.copy_(_mix(world * _GAMMA + derive_seed(seed, name)).unsqueeze(1))
        self._counter.zero_()

    def bits(self, size: int) -> Tensor:
        """(N, size) int64, uniform over all bit patterns."""
        draw = torch.arange(size, dtype=torch.int64, device=self._key.device) + self._counter
        self._counter += size
        return _mix(_mix(self._key ^ (draw * _GAMMA)) + _GAMMA)

    def uniform(self, size: int) -> Tensor:
        """(N, size) float32 in [0, 1)."""
        return _shift(self.bits(size), 40).to(torch.float32) * 2.0**-24

    def normal(self, size: int) -> Tensor:
        """(N, size) float32, standard normal (Box–Muller)."""
        bits = self.bits((size + 1) // 2)
        radius = torch.sqrt(-2.0 * torch.log((_shift(bits, 40).to(torch.float32) + 1.0) * 2.0**-24))
        angle = (bits & 0xFFFFFF).to(torch.float32) * (2.0 * math.pi * 2.0**-24)
        return torch.cat([radius * torch.cos(angle), radius * torch.sin(angle)], dim=1)[:, :size]

    def give_back(self, worlds: Tensor, before: dict[str, Tensor]) -> None:
        """In `worlds` (N,), which did not use them, undo the draws since the state `before`."""
        self._counter.copy_(torch.where(worlds.unsqueeze(1), before["counter"], self._counter))

    def state_dict(self) -> dict[str, Tensor]:
        return {"counter": self._counter.clone()}

    def load_state_dict(self, state: dict[str, Tensor]) -> None:
        self._counter.copy_(state["counter"])
