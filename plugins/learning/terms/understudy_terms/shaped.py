"""The option for the shape of a field that is kept or observed as it is."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

from understudy.options import check_range


@dataclass(frozen=True)
class Shaped:
    """Options of parts that take values as they are."""

    shape: tuple[int, ...] = ()  #: shape of the value, without N: [3] for a position

    def __post_init__(self) -> None:
        check_shape(self)


def check_shape(options: Any) -> None:
    """Raise :class:`ValueError` if the `shape` of these options is not possible."""
    check_range(options, "shape", least=1)
    if math.prod(options.shape) > 10_000:
        raise ValueError(f"shape={options.shape} is not possible: give at most 10000 values.")
