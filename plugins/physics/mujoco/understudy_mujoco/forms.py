"""A body that has another shape in each world.

A model has the same geoms in all worlds. So the body has one of every kind, all around its origin, and in each world all but one
touch nothing (``active/GEOM``); that one has the world's size, and the body its mass and inertia. Both simulators take it. m, kg.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

import mujoco
import numpy as np
import torch
from torch import Tensor

__all__ = ["KINDS", "Forms", "lie_along_x", "solid"]

KINDS: dict[str, mujoco.mjtGeom] = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "cylinder": mujoco.mjtGeom.mjGEOM_CYLINDER,
    "ellipsoid": mujoco.mjtGeom.mjGEOM_ELLIPSOID,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}
#: m, of forms that no world has yet.
_SIZE = 0.01


def lie_along_x(geom: mujoco.MjsGeom) -> None:
    """Turn a capsule or a cylinder, whose axis is MuJoCo's z, to lie along its body's x."""
    if geom.type in (KINDS["capsule"], KINDS["cylinder"]):
        half = math.sqrt(0.5)
        geom.quat = [half, 0, half, 0]


def solid(kind: str, sizes: Tensor) -> tuple[Tensor, Tensor]:
    """Volume (…) m³, and inertia (…, 3) m² about the body's axes of a mass of 1 kg: of a solid of MuJoCo's `sizes` (…, 3) m, a capsule and a
    cylinder along x."""
    a, b, c = sizes.unbind(-1)
    squares = torch.stack([b * b + c * c, a * a + c * c, a * a + b * b], dim=-1)
    if kind == "box":
        return 8.0 * a * b * c, squares / 3.0
    if kind == "ellipsoid":
        return 4.0 / 3.0 * math.pi * a * b * c, squares / 5.0
    ball, tube = 4.0 / 3.0 * math.pi * a**3, 2.0 * math.pi * a * a * b
    round_ = 0.4 * a * a
    if kind == "sphere":
        return ball, torch.stack([round_] * 3, dim=-1)
    along, across = 0.5 * a * a, 0.25 * a * a + b * b / 3.0
    if kind == "cylinder":
        return tube, torch.stack([along, across, across], dim=-1)
    # Two half balls, whose middles are b + 3/8 a from the capsule's.
    share = ball / (ball + tube)
    ends = round_ + b * b + 0.75 * a * b
    across = (1.0 - share) * across + share * ends
    return ball + tube, torch.stack([(1.0 - share) * along + share * round_, across, across], -1)


@dataclass(frozen=True)
class Forms:
    """What the body `body` may be."""

    body: str
    kinds: tuple[str, ...]
    density: float  #: kg/m³

    def geom(self, kind: str) -> str:
        """Name of the form `kind`."""
        return f"{self.body}_{kind}"

    @property
    def varies(self) -> tuple[str, ...]:
        """The simulator's parameters that make the difference."""
        geoms = [self.geom(kind) for kind in self.kinds]
        of_geoms = [f"{field}/{name}" for name in geoms for field in ("active", "geom_size")]
        return (*of_geoms, f"body_mass/{self.body}", f"body_inertia/{self.body}")

    def add(self, body: mujoco.MjsBody, **options: Any) -> None:
        """Give `body` all of them, as geoms with these `options`."""
        for kind in self.kinds:
            size = [_SIZE] * 3
            lie_along_x(
                body.add_geom(
                    name=self.geom(kind), type=KINDS[kind], size=size, mass=0.0, **options
                )
            )
        volume, inertia = solid("sphere", torch.full((3,), _SIZE, dtype=torch.float64))
        body.explicitinertial, body.mass = True, self.density * float(volume)
        body.ipos = np.zeros(3)  # else MuJoCo takes the body's own place
        body.inertia = (body.mass * inertia).tolist()

    def values(self, kind: Tensor, sizes: Tensor) -> dict[str, Tensor]:
        """What :attr:`varies` are where world n is number `kind` (N,) of the kinds, of MuJoCo's `sizes` (N, 3) m."""
        found: dict[str, Tensor] = {}
        mass, inertia = torch.zeros_like(sizes[:, 0]), torch.zeros_like(sizes)
        for number, name in enumerate(self.kinds):
            own = kind == number
            some = torch.where(own[:, None], sizes, _SIZE)
            volume, unit = solid(name, some)
            mass = torch.where(own, self.density * volume, mass)
            inertia = torch.where(own[:, None], self.density * volume[:, None] * unit, inertia)
            found |= {
                f"active/{self.geom(name)}": own.to(sizes.dtype),
                f"geom_size/{self.geom(name)}": some,
            }
        return {
            **found,
            f"body_mass/{self.body}": mass,
            f"body_inertia/{self.body}": inertia,
        }

    def show(self, model: mujoco.MjModel, tracks: Mapping[str, np.ndarray], frame: int) -> None:
        """Make the `model` look as the world was in that frame of its recorded :attr:`varies`; without them all forms are seen."""
        for geom in map(self.geom, self.kinds):
            if f"active/{geom}" in tracks:
                model.geom(geom).rgba[3] = float(tracks[f"active/{geom}"][frame] > 0)
                model.geom(geom).size[:] = tracks[f"geom_size/{geom}"][frame]
