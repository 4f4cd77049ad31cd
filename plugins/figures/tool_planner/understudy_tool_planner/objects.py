"""What sticks take: spheres, capsules and boxes (thesis, table 5.2), as rounded boxes.

A box whose edges and corners are rounded by a radius is a sphere where its sizes are 0, a capsule where only
one is not, and a box where the radius is 0. So distances to all of them are one function. m, rad.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.errors import ConfigError

__all__ = ["COUNTS", "KINDS", "Shape"]

KINDS = ("sphere", "capsule", "box")
#: How many sizes each has.
COUNTS = {"sphere": 1, "capsule": 2, "box": 3}
#: m, table 5.2: radius; length of a capsule; width, length and height of a box.
RADIUS, LENGTH, SIDE = (0.005, 0.01), (0.02, 0.04), (0.01, 0.02)


@dataclass(frozen=True)
class Shape:
    """An object of table 5.2."""

    kind: str  #: of KINDS
    #: m: radius of a sphere; radius and length (of the cylinder) of a capsule; the three sides of a box.
    sizes: tuple[float, ...]

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ConfigError(f"'{self.kind}' is no object: there are {', '.join(KINDS)}.")
        ranges = {
            "sphere": {"radius": RADIUS},
            "capsule": {"radius": RADIUS, "length": LENGTH},
            "box": {"width": SIDE, "length": SIDE, "height": SIDE},
        }[self.kind]
        if len(self.sizes) != len(ranges):
            raise ConfigError(
                f"A {self.kind} has {len(ranges)} sizes ({', '.join(ranges)}), and not {len(self.sizes)}."
            )
        for (name, (low, high)), size in zip(ranges.items(), self.sizes, strict=True):
            if not low - 1e-9 <= size <= high + 1e-9:
                raise ConfigError(
                    f"A {self.kind} with a {name} of {100 * size:g} cm is none of table 5.2, where it is from "
                    f"{100 * low:g} to {100 * high:g} cm."
                )

    @property
    def half_sizes(self) -> tuple[float, float, float]:
        """m, of the box inside the rounding, along the object's axes; a capsule lies along x."""
        if self.kind == "box":
            width, length, height = self.sizes
            return 0.5 * width, 0.5 * length, 0.5 * height
        return (0.5 * self.sizes[1], 0.0, 0.0) if self.kind == "capsule" else (0.0, 0.0, 0.0)

    @property
    def rounding(self) -> float:
        """m."""
        return 0.0 if self.kind == "box" else self.sizes[0]

    @property
    def height(self) -> float:
        """m: of the middle above what it lies on."""
        return self.half_sizes[2] + self.rounding

    @property
    def reach(self) -> float:
        """m: of the sphere around it."""
        return sum(s * s for s in self.half_sizes) ** 0.5 + self.rounding


@dataclass(frozen=True)
class Things:
    """K objects somewhere, as rounded boxes."""

    places: Tensor  #: (K, 3) m
    turns: Tensor  #: (K, 3, 3) their axes as columns
    sizes: Tensor  #: (K, 3) m, half
    rounding: Tensor  #: (K,) m

    @staticmethod
    def of(shapes: list[Shape], places: Tensor, headings: Tensor) -> Things:
        """Lying on the table, turned about the vertical: places (K, 2) m, headings (K,) rad."""
        heights = torch.tensor([s.height for s in shapes], dtype=places.dtype)
        return Things(
            torch.cat([places, heights[:, None]], dim=1),
            upright(headings),
            torch.tensor([s.half_sizes for s in shapes], dtype=places.dtype).reshape(-1, 3),
            torch.tensor([s.rounding for s in shapes], dtype=places.dtype),
        )


def upright(heading: Tensor) -> Tensor:
    """(…, 3, 3): turned by `heading` (…) rad about the vertical."""
    sine, cosine, zero = heading.sin(), heading.cos(), torch.zeros_like(heading)
    rows = [cosine, -sine, zero, sine, cosine, zero, zero, zero, zero + 1.0]
    return torch.stack(rows, dim=-1).unflatten(-1, (3, 3))
