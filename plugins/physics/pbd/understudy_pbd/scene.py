"""What is simulated: particles of some materials, springs between them, kinematic tools, a table."""

from __future__ import annotations

import hashlib
from abc import abstractmethod
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from understudy.options import check_range
from understudy.task import Scene
from understudy_pbd.rules import Rule
from understudy_warp_torch.tools import Box, Capsule, Grid, Shape, TaperedCapsule, Tool

__all__ = [
    "Box", "Capsule", "Fluid", "Grid", "Material", "ParticleModel", "ParticleScene", "Shape", "Springs",
    "Table", "TaperedCapsule", "Tool", "pan",
]  # fmt: skip

#: One number for all particles, or one for each, (P,).
PerParticle = float | Sequence[float] | np.ndarray


@dataclass(frozen=True)
class Fluid:
    """The density constraint of position-based fluids (Macklin et al. 2014, section 7.1; Macklin and
    Müller 2013) and XSPH viscosity. All particles of a fluid have one mass."""

    rest_density: float  #: kg/m³
    smoothing: float  #: m, h: the kernels' radius; about twice the distance of neighbours at rest
    #: share of the neighbours' mean velocity taken over in a sub-step, [0, 1]
    viscosity: float = 0.05
    #: share of the density constraint that also pulls, where density is too low
    tension: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "rest_density", "smoothing", above=0)
        check_range(self, "viscosity", "tension", least=0, most=1)


@dataclass(frozen=True)
class Material:
    """How particles touch each other, tools and the table. Of two that touch, numbers are averaged.

    Grains are a material without anything else; `fluid` makes a liquid, in which particles do not
    touch but keep their density. Elastic and plastic bodies are grains tied by springs.
    """

    friction: float = 0.4  #: dynamic (Macklin et al. 2014, section 6.1)
    static_friction: float | None = None  #: null: as `friction`
    #: share of a gap within `cohesion_range` that closes in an iteration, [0, 1]
    cohesion: float = 0.0
    cohesion_range: float = 0.25  #: of the sum of two radii
    damping: float = 0.0  #: 1/s, drag of the air
    fluid: Fluid | None = None

    def __post_init__(self) -> None:
        check_range(self, "friction", "cohesion_range", "damping", least=0)
        check_range(self, "cohesion", least=0, most=1)
        if self.static_friction is not None:
            check_range(self, "static_friction", least=self.friction)


def pan(
    radius: float, height: float, thickness: float = 0.01, sides: int = 12, handle: float = 0.0
) -> tuple[Shape, ...]:
    """A round pan from boxes: a bottom whose upper side is at z = 0, a wall of so many `sides` and
    `height`, and a handle of that length along x (m)."""
    half = 0.5 * thickness
    width = radius * float(np.tan(np.pi / sides)) + half
    shapes: list[Shape] = []
    for side in range(sides):
        angle = 2 * np.pi * side / sides
        turn = (float(np.cos(0.5 * angle)), 0.0, 0.0, float(np.sin(0.5 * angle)))
        c, s = float(np.cos(angle)), float(np.sin(angle))
        if side < (sides + 1) // 2:  # strips through the centre cover the bottom
            shapes.append(Box((radius, width, half), (0.0, 0.0, -half), turn))
        at = radius + half
        shapes.append(
            Box(
                (half, width + half, 0.5 * height + half),
                (at * c, at * s, 0.5 * height - half),
                turn,
            )
        )
    if handle > 0:
        at = radius + thickness + 0.5 * handle
        shapes.append(Box((0.5 * handle, thickness, thickness), (at, 0.0, 0.5 * height)))
    return tuple(shapes)


@dataclass(frozen=True)
class Table:
    """The plane z = 0, and walls where `lower` and `upper` are given: x and y stay between them."""

    friction: float = 0.4
    lower: tuple[float, float] | None = None  #: m
    upper: tuple[float, float] | None = None  #: m


@dataclass(frozen=True)
class Springs:
    """Distance constraints |x_i − x_j| = L_ij; `slots` is the most that one particle can have.

    They can be made, changed and removed while the simulation runs, by a :class:`Rule`.
    """

    pairs: np.ndarray = field(default_factory=lambda: np.zeros((0, 2), np.int64))  #: (S, 2)
    lengths: np.ndarray = field(default_factory=lambda: np.zeros(0))  #: (S,), m
    slots: int = 0  #: K; 0 takes as many as the pairs need
    stiffness: float = 1.0  #: share of an error that an iteration corrects, (0, 1]

    def __post_init__(self) -> None:
        check_range(self, "stiffness", above=0, most=1)
        check_range(self, "slots", least=0)


@dataclass(frozen=True)
class ParticleModel:
    """Everything that a simulator of particles needs to know of a scene. P particles, in the order of
    memory: neighbours in space should be neighbours here."""

    positions: np.ndarray  #: (P, 3), m: where particles are at first
    radius: PerParticle  #: m, half the distance at which two touch
    mass: PerParticle  #: kg; 0 is a particle that does not move
    #: index into `materials`, of all or of each (P,)
    material: int | Sequence[int] | np.ndarray = 0
    materials: tuple[Material, ...] = (Material(),)
    springs: Springs = field(default_factory=Springs)
    tools: tuple[Tool, ...] = ()  #: T
    table: Table | None = field(default_factory=Table)
    gravity: tuple[float, float, float] = (0.0, 0.0, -9.81)  #: m/s²
    rules: tuple[Rule, ...] = ()  #: what else happens in a sub-step, in this order
    colours: np.ndarray | None = None  #: (P, 3) in [0, 1], for pictures


class ParticleScene(Scene):
    """A scene of particles. All N worlds have the same P particles, of which some may be inactive."""

    recorded = ("particle_position", "tool_position", "tool_orientation", "active_particles")

    @abstractmethod
    def model(self) -> ParticleModel:
        """The scene, the same at each call; but its rules, which belong to one simulator, anew."""

    def describe(self) -> dict[str, Any]:
        model = self.model()
        count = len(model.positions)
        return {
            "particles": count,
            "mass_kg": float(np.broadcast_to(np.asarray(model.mass, float), count).sum()),
            "materials": len(model.materials),
            "tools": len(model.tools),
        }

    def identity(self) -> Mapping[str, str]:
        """The particles': their radii, materials, and which are tied how far apart, to 1 µm."""
        model = self.model()
        count, springs = len(model.positions), model.springs
        radius = np.broadcast_to(np.asarray(model.radius, float), count)
        material = np.broadcast_to(np.asarray(model.material), count)
        found = hashlib.sha256()
        for part in (1e6 * radius, material, springs.pairs, 1e6 * np.asarray(springs.lengths)):
            found.update(np.rint(part).astype("<i8").tobytes())
        return {"particle_position": f"{count} particles ({found.hexdigest()[:12]})"}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """Particles in their colours, or the colours of their materials, tools and the table."""
        from understudy_pbd.drawing import draw

        yield from draw(self.model(), tracks, width, height, self.azimuth)
