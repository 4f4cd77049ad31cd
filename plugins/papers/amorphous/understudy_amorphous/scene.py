"""What is on the table: blocks of a material, and a scraper or a pan."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np

from understudy.options import check_range
from understudy.task import Context
from understudy_amorphous.viscoplastic import Plasticity, ViscoPlastic
from understudy_pbd.scene import (
    Box,
    Fluid,
    Material,
    ParticleModel,
    ParticleScene,
    Springs,
    Table,
    Tool,
    pan,
)

#: kg/m³, of every material: water's.
DENSITY = 1000.0
BUTTER, PATTY = (0.96, 0.80, 0.38), (0.52, 0.31, 0.20)


@dataclass(frozen=True)
class Substance:
    """A material: at what distance its particles touch, and what ties them."""

    material: Material
    #: Half the distance at which two particles touch, as a share of half their distance at rest. What
    #: springs hold apart touches later, so that it can be compressed.
    contact: float = 1.0
    #: Where it is elastic: how far apart particles are tied, as a share of their distance at rest.
    ties: float | None = None
    #: Share of a tie's error that a sub-step corrects.
    stiffness: float = 0.9
    plasticity: Plasticity | None = None
    colour: tuple[float, float, float] = (0.93, 0.89, 0.80)  #: of pictures: rice


def _granular(distance: float) -> Substance:
    return Substance(Material(friction=1.0))


def _viscous(distance: float) -> Substance:
    fluid = Fluid(rest_density=DENSITY, smoothing=2.0 * distance, viscosity=0.9, tension=0.2)
    return Substance(Material(friction=1.0, fluid=fluid), colour=(0.85, 0.56, 0.20))


def _viscoplastic(distance: float) -> Substance:
    return Substance(Material(friction=0.4), contact=0.8, plasticity=Plasticity(), colour=BUTTER)


def _elastic(distance: float) -> Substance:
    return Substance(Material(friction=0.4), contact=0.8, ties=2.1, colour=PATTY)


SUBSTANCES: dict[str, Callable[[float], Substance]] = {
    "granular": _granular,
    "viscoplastic": _viscoplastic,
    "viscous": _viscous,
    "elastic": _elastic,
}


def scraper(width: float, height: float, thickness: float) -> Tool:
    """An upright blade; its frame is at the middle of its lower edge, which is along y."""
    half = (0.5 * thickness, 0.5 * width, 0.5 * height)
    return Tool((Box(half, (0.0, 0.0, 0.5 * height)),), friction=0.2)


PAN_RADIUS = 0.9  #: m

TOOLS: dict[str, Callable[[], Tool]] = {
    "scraper": lambda: scraper(width=1.2, height=0.8, thickness=0.1),
    "pan": lambda: Tool(
        pan(radius=PAN_RADIUS, height=0.3, thickness=0.1, handle=1.2), friction=0.4
    ),
}


_PARTICLES = 100_000  #: the most that a scene has
_ROW = 500.0  #: m of blocks beside one another; what is 1 km away has flown


def row_gap(block: tuple[int, int, int], spacing: float) -> float:
    """m from one of the blocks that stand in a row to the next."""
    return 4.0 * max(block) * spacing


class AmorphousScene(ParticleScene):
    """Blocks of particles on a table, and a tool.

    Lengths follow from Table 2 and Tables 3 to 5: particles 0.2 m apart, on a map of 32 × 32 cells of
    0.2 m (docs/papers/amorphous.md says how).
    """

    @dataclass(frozen=True)
    class Options:
        #: what the particles are (sections 4.1 to 4.6)
        material: Literal["granular", "viscoplastic", "viscous", "elastic"] = "viscoplastic"
        blocks: int = 4  #: how many pieces of material there are
        block: tuple[int, int, int] = (5, 5, 2)  #: how many particles a block has along x, y and z
        round: bool = False  #: whether a block has only the particles within its inscribed cylinder
        spacing: float = 0.2  #: m, distance between particles at rest
        #: Particles along each axis for one of `block`: 2 and 3 are Table 5's medium and high.
        resolution: int = 1
        tool: Literal["scraper", "pan"] = "scraper"  #: the tool that moves the particles
        #: greatest number of springs that one particle of a visco-plastic material can have
        springs: int = 32

        def __post_init__(self) -> None:
            check_range(self, "blocks", "resolution", "springs", least=1, most=1000)
            check_range(self, "block", most=1000)
            if self.blocks * math.prod(self.block) * self.resolution**3 > _PARTICLES:
                raise ValueError(
                    f"blocks={self.blocks} is not possible: with this block and resolution there would be more "
                    f"than {_PARTICLES} particles."
                )
            check_range(self, "spacing", above=0, most=1e3)
            if min(self.block) < 1:
                raise ValueError(
                    f"block={list(self.block)} is not possible: give at least 1 for each axis."
                )
            if (row := self.blocks * row_gap(self.block, self.spacing)) > _ROW:
                raise ValueError(
                    f"blocks={self.blocks} is not possible: side by side they would reach {row:.3g} m, and at most {_ROW:g} are "
                    "possible. Give fewer or smaller ones, or less spacing."
                )

    recorded = (*ParticleScene.recorded, "goal")

    def __init__(self, options: Options, context: Context) -> None:
        self.options = options
        #: m, between particles at rest.
        self.distance = options.spacing / options.resolution
        self.substance = SUBSTANCES[options.material](self.distance)
        #: (B, 3) m, one block around the middle of its lower side, its lowest particles half their
        #: distance above it.
        self.block = lattice(options.block, options.resolution, self.distance, options.round)

    @property
    def radius(self) -> float:
        """m, half the distance at which two particles touch."""
        return 0.5 * self.distance * self.substance.contact

    def _colours(self, particles: int) -> np.ndarray:
        return np.tile(np.array(self.substance.colour), (particles, 1))

    def place(self, blocks: int) -> np.ndarray:
        """(blocks · B, 3) m: blocks in a row, where nothing touches anything."""
        gap = row_gap(self.options.block, self.options.spacing)
        along = np.arange(blocks, dtype=np.float64) * gap
        shift = np.stack([along, np.zeros(blocks), np.zeros(blocks)], axis=1)
        return (shift[:, None] + self.block[None]).reshape(-1, 3)

    def model(self) -> ParticleModel:
        options, substance = self.options, self.substance
        positions = self.place(options.blocks)
        plasticity = substance.plasticity
        springs, rules = Springs(), ()
        if plasticity is not None:
            pairs, lengths = near_pairs(positions, plasticity.merge * self.distance)
            springs = Springs(pairs, lengths, options.springs, plasticity.stiffness)
            rules = (ViscoPlastic(plasticity, self.distance),)
        elif substance.ties is not None:
            pairs, lengths = near_pairs(positions, substance.ties * self.distance)
            springs = Springs(pairs, lengths, stiffness=substance.stiffness)
        return ParticleModel(
            positions=positions,
            radius=self.radius,
            mass=DENSITY * self.distance**3,
            materials=(substance.material,),
            springs=springs,
            tools=(TOOLS[options.tool](),),
            table=Table(friction=0.8),
            rules=rules,
            colours=self._colours(len(positions)),
        )

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 960, height: int = 540
    ) -> Iterator[np.ndarray]:
        """With a red ball where the goal is, if there is one."""
        if "goal" not in tracks:
            yield from super().draw(tracks, width, height)
            return
        model, goal = self.model(), tracks["goal"]
        ball = np.concatenate([goal, np.zeros_like(goal[:, :1])], axis=1)[:, None]
        there = np.ones_like(goal[:, :1])
        marked = dataclasses.replace(
            model,
            positions=np.concatenate([model.positions, ball[0]]),
            radius=np.append(np.full(len(model.positions), self.radius), 0.1),
            colours=np.concatenate([self._colours(len(model.positions)), [[0.85, 0.15, 0.12]]]),
        )
        shown = {
            **tracks,
            "particle_position": np.concatenate([tracks["particle_position"], ball], axis=1),
            "active_particles": np.concatenate([tracks["active_particles"], there], axis=1),
        }
        from understudy_pbd.drawing import draw

        yield from draw(marked, shown, width, height, self.azimuth)

    def describe(self) -> dict[str, Any]:
        return {**super().describe(), "material": self.options.material}


def lattice(
    block: tuple[int, int, int], resolution: int, distance: float, cylinder: bool
) -> np.ndarray:
    """(B, 3) m: a block's particles on a cubic lattice, in the order of x, then y, then z."""
    counts = [n * resolution for n in block]
    axes = [distance * (np.arange(n) - 0.5 * (n - 1)) for n in counts[:2]]
    axes.append(distance * (np.arange(counts[2]) + 0.5))
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    if cylinder:
        most = 0.5 * distance * min(counts[:2])
        points = points[np.hypot(points[:, 0], points[:, 1]) <= most]
    return points


def near_pairs(points: np.ndarray, within: float) -> tuple[np.ndarray, np.ndarray]:
    """The pairs (S, 2) of points (P, 3) less than `within` m apart, and how far they are, (S,)."""
    found: list[np.ndarray] = []
    for i in range(len(points) - 1):
        distance = np.linalg.norm(points[i + 1 :] - points[i], axis=1)
        partner = np.flatnonzero(distance < within) + i + 1
        found.append(np.stack([np.full_like(partner, i), partner], axis=1))
    pairs = np.concatenate(found) if found else np.zeros((0, 2), np.int64)
    lengths = np.linalg.norm(points[pairs[:, 0]] - points[pairs[:, 1]], axis=1)
    return pairs, lengths
