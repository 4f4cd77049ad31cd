"""The space of a search: options of the configuration and their ranges, as the unit cube."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import torch
from torch import Tensor

__all__ = ["Parameter", "check_paths"]


@dataclass(frozen=True)
class Parameter:
    """The range of one option of the configuration.

    On a log scale equal ratios are equally far apart, as they are for learning rates.
    """

    low: float  #: the least value, in the option's unit; on a log scale above 0
    high: float  #: the greatest value, in the option's unit
    scale: Literal["linear", "log"] = "linear"  #: by what values are spread: differences or ratios
    integer: bool = False  #: whether the option takes whole numbers only

    def __post_init__(self) -> None:
        if not self.low < self.high:
            raise ValueError(
                f"low={self.low:g} is not possible: it must be less than high={self.high:g}."
            )
        if self.scale == "log" and self.low <= 0:
            raise ValueError(
                f"low={self.low:g} is not possible: it must be greater than 0 on a log scale."
            )
        if self.integer and not (float(self.low).is_integer() and float(self.high).is_integer()):
            raise ValueError(
                f"integer=true is not possible with low={self.low:g} and high={self.high:g}: "
                "give whole numbers."
            )

    def value(self, u: float) -> float:
        """The value at `u` in [0, 1], of six digits, as a configuration can be read."""
        low, high = self._bounds
        value = low + (high - low) * min(max(u, 0.0), 1.0)
        value = math.exp(value) if self.scale == "log" else value
        if self.integer:
            return min(max(round(value), int(self.low)), int(self.high))
        return min(max(float(f"{value:.6g}"), self.low), self.high)

    def unit(self, value: float) -> float:
        """Where `value` lies between low, 0, and high, 1."""
        low, high = self._bounds
        return ((math.log(value) if self.scale == "log" else value) - low) / (high - low)

    @property
    def _bounds(self) -> tuple[float, float]:
        if self.scale == "log":
            return math.log(self.low), math.log(self.high)
        return self.low, self.high


#: What the path of an option looks like: ``learner.epochs``.
_PATH = re.compile(r"[A-Za-z_]\w*(\.\w+)*")


def check_paths(parameters: Mapping[str, Parameter]) -> None:
    """Raise a ValueError unless `parameters` names options of a configuration."""
    if not parameters:
        raise ValueError("parameters must not be empty: name options to search over.")
    for name in parameters:
        if not _PATH.fullmatch(name):
            raise ValueError(
                f"parameters names '{name}', which is no option: write its path, like learner.epochs."
            )


class Space:
    """Points by option, and the same points in the unit cube (d,)."""

    def __init__(self, parameters: Mapping[str, Parameter]) -> None:
        self._parameters = dict(parameters)

    def __len__(self) -> int:
        return len(self._parameters)

    @property
    def ranges(self) -> dict[str, tuple[float, float]]:
        """By option, the least and the greatest value of its range, as the configuration is given them."""
        return {name: (p.value(0.0), p.value(1.0)) for name, p in self._parameters.items()}

    def point(self, u: Sequence[float]) -> dict[str, float]:
        """The point at `u` (d,) of the unit cube, every value one that the configuration accepts."""
        pairs = zip(self._parameters.items(), u, strict=True)
        return {name: parameter.value(share) for (name, parameter), share in pairs}

    def unit(self, point: Mapping[str, float]) -> list[float]:
        """Where `point`, which may name other options besides, lies in the unit cube."""
        return [parameter.unit(point[name]) for name, parameter in self._parameters.items()]

    def rounded(self, x: Tensor) -> Tensor:
        """`x` (m, d) of the unit cube with integer parameters at whole values; gradients are those of x
        ("straight-through"), so that an ascent can still leave a value for the next."""
        whole = [p.integer for p in self._parameters.values()]
        if not any(whole):
            return x
        taken = [self.unit(self.point(row)) for row in x.detach().clamp(0.0, 1.0).tolist()]
        return torch.where(torch.tensor(whole), x + (torch.tensor(taken).to(x) - x).detach(), x)

    def has(self, point: Mapping[str, float]) -> bool:
        """Whether `point` has all of the options, each within its range."""
        return all(
            name in point and parameter.low <= point[name] <= parameter.high
            for name, parameter in self._parameters.items()
        )
