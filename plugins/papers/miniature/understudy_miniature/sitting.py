"""What sitting has beyond points on a plane: when a point sits."""

from __future__ import annotations

from dataclasses import dataclass

from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields


class Contact(Fields):
    """Whether the point is at rest on the seat: near enough and slow enough, 1 or 0."""

    reads = ("distance", "velocity")
    provides = {"seated": ()}

    @dataclass(frozen=True)
    class Options:
        radius: float = 0.3  #: m, above 0, within which it is on the seat
        speed: float = 0.3  #: m/s, above 0, below which it is at rest

        def __post_init__(self) -> None:
            check_range(self, "radius", "speed", above=0, most=1e3)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options

    def compute(self, distance: Tensor, velocity: Tensor) -> dict[str, Tensor]:
        options = self._options
        seated = (distance < options.radius) & (velocity.norm(dim=1) < options.speed)
        return {"seated": seated.float()}
