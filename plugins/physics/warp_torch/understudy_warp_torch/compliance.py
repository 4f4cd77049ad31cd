"""Artificial compliance: what position-based dynamics gives under a load for want of sub-steps, however stiff the material."""

from __future__ import annotations

import math
import warnings
from collections.abc import Callable
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError

__all__ = ["Compliance", "Loads"]


@dataclass(frozen=True)
class Compliance:
    """By what share cloth becomes longer, or a pile lower: `per_load` × load × Δt², of a load in m/s², gravity less the
    acceleration of what carries it, and of sub-steps of Δt."""

    per_load: float  #: 1/m
    length: float  #: m, of what becomes longer or lower
    told: float  #: share beyond which it is told
    refused: float  #: and that beyond which it is refused
    says: Callable[[float, int], str]  #: a share in words, and how many sub-steps a second would do

    def share(self, load: float, dt: float) -> float:
        return self.per_load * load * dt**2

    def sub_steps(self, load: float) -> float:
        """Hz: with so many a second the share is the one beyond which it is told."""
        return math.sqrt(self.share(load, 1.0) / self.told)

    def response(self, dt: float) -> float:
        """s: how long a load lasts that has its whole effect, in sub-steps of `dt` s. It is 1/ω of the slowest vibration of
        a rod that its own weight makes so much longer, ω² = π² / 8 × load / (share × length)."""
        return math.sqrt(8 * self.share(1.0, dt) * self.length) / math.pi

    def check(self, load: float, dt: float, more: str = "") -> None:
        """Warn of the share under `load`, or refuse it, with `more` to say.

        Raises
        ------
        ConfigError
            if it is beyond `refused`.
        """
        share = self.share(load, dt)
        if share <= self.told:
            return
        text = self.says(share, math.ceil(self.sub_steps(load))) + more
        if share > self.refused:
            raise ConfigError(text)
        warnings.warn(text, stacklevel=2)


class Loads:
    """Counts the steps of worlds whose gravity and accelerating tools load sub-steps of `dt` s with more than would be told.

    What lasts shorter than :meth:`Compliance.response` counts the less: it is over before the material has given way. (Of what
    is taken back at once, as a jerk of one step, it makes up to twice too much; and what a tool turns by is not counted.)
    """

    def __init__(
        self, compliance: Compliance, dt: float, gravity: Tensor, velocity: Tensor
    ) -> None:
        """`gravity` (N, 3) m/s² and tools' `velocity` (N, T, 3) m/s are the simulator's own memory."""
        self._most = compliance.told / max(compliance.share(1.0, dt), 1e-12)  # m/s²
        self._seconds, self._dt = compliance.response(dt), dt
        self._gravity, self._velocity = gravity, velocity
        self._lagging = (
            velocity.clone()
        )  #: the velocity, as a low-pass filter of so many seconds has it
        self.count = torch.zeros(len(gravity), dtype=torch.int64, device=gravity.device)  #: (N,)

    def forget(self, worlds: Tensor) -> None:
        """Worlds (N,) bool begin anew, with tools as fast as they are."""
        torch.where(worlds[:, None, None], self._velocity, self._lagging, out=self._lagging)

    def add(self, substeps: int, carries: Tensor) -> None:
        """After so many sub-steps, in which tools carried something where `carries` (N, T) bool."""
        time = substeps * self._dt
        kept = math.exp(-time / self._seconds) if self._seconds else 0.0
        change = (1.0 - kept) * (self._velocity - self._lagging)
        self._lagging += change
        felt = self._gravity[:, None] - torch.where(carries[..., None], change / time, 0.0)
        felt = torch.cat([self._gravity[:, None], felt], dim=1)
        self.count += felt.norm(dim=2).amax(1) > self._most
