"""What kinematic bodies consist of. Descriptions only: the device's side is in :mod:`understudy_warp_torch.shapes`."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

__all__ = ["Box", "Capsule", "Grid", "Shape", "TaperedCapsule", "Tool"]


@dataclass(frozen=True)
class Box:
    """A box in its tool's frame."""

    half_extents: tuple[float, float, float]  #: m
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: m, of its centre
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  #: wxyz


@dataclass(frozen=True)
class Capsule:
    """A capsule along its z axis, in its tool's frame; without length a sphere."""

    radius: float  #: m
    half_length: float  #: m, of the cylinder
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: m, of its centre
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  #: wxyz


@dataclass(frozen=True)
class TaperedCapsule:
    """The hull of two spheres on its z axis, in its tool's frame."""

    radii: tuple[float, float]  #: m, of the sphere at −`half_length`, and of that at +`half_length`
    half_length: float  #: m, half the distance between their centres
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: m, half-way between them
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  #: wxyz

    def __post_init__(self) -> None:
        if min(self.radii) <= 0 or abs(self.radii[0] - self.radii[1]) >= 2 * self.half_length:
            raise ValueError(
                f"radii={self.radii} at {2 * self.half_length:g} m from each other are no tapered "
                "capsule: both must be above 0, and neither sphere may lie within the other."
            )


@dataclass(frozen=True)
class Grid:
    """Any shape, as signed distances (m, negative inside) at the points of a grid in its tool's
    frame; between points they are linear. It goes on for two particle radii around the shape."""

    distances: np.ndarray  #: (X, Y, Z)
    spacing: float  #: m, between points
    origin: tuple[float, float, float]  #: m, of point (0, 0, 0)


Shape = Box | Capsule | TaperedCapsule | Grid


@dataclass(frozen=True)
class Tool:
    """A rigid body that goes where the control says and that nothing can hold."""

    shapes: tuple[Shape, ...]
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)  #: m, where it is at first
    orientation: tuple[float, float, float, float] = (1.0, 0.0, 0.0, 0.0)  #: wxyz
    friction: float = 0.4
