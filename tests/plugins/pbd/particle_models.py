"""Scenes that several tests use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from granular import MASS, RADIUS, Yielding, disturbed, lattice, tied

from understudy_pbd.scene import Box, Fluid, Material, ParticleModel, Tool

BLOCK = disturbed(lattice((3, 3, 3), 2 * RADIUS, (0, 0, RADIUS)), 0.05 * RADIUS)
SCRAPER = Tool((Box((0.005, 0.05, 0.03)),), (-0.1, 0.0, 0.03))


def grains(**changes: Any) -> ParticleModel:
    return ParticleModel(BLOCK, RADIUS, MASS, **{"tools": (SCRAPER,), **changes})


def everything() -> ParticleModel:
    """A tied body on a puddle, two tools, particles of two sizes, and a rule."""
    body, puddle = BLOCK + np.array([0, 0, 0.1]), BLOCK[9:]
    water = Material(0.0, fluid=Fluid(1000.0, 4 * RADIUS, 0.2))
    return ParticleModel(
        np.concatenate([body, puddle]),
        np.repeat([0.9 * RADIUS, RADIUS], [27, 18]),
        np.repeat([MASS, 0.008], [27, 18]),
        np.repeat([0, 1], [27, 18]),
        materials=(Material(0.5, cohesion=0.2, damping=0.1), water),
        springs=tied(body, 3 * RADIUS, slots=20),
        tools=(SCRAPER, Tool((Box((0.05, 0.05, 0.005)),), (0.0, 0.0, 0.3))),
        rules=(Yielding(0.1, 0.2),),
    )


MODELS: dict[str, Callable[[], ParticleModel]] = {
    "grains": grains,
    "everything": everything,
    "no tool": lambda: grains(tools=()),
}
