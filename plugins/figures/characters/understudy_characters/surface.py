"""How low the parts of a character reach, batched.

Every geom is the sum (Minkowski's) of a box and an ellipsoid about the same centre: a capsule is a line
and a ball, a cylinder a line and a disc. So the lowest point of each is one formula. A mesh is
represented by its extreme vertices.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.layout import Layout

#: m: a link without colliding geoms is this high above the floor, which it cannot touch.
FAR = 1e3
#: Directions in which a mesh's extreme vertices are looked for.
_DIRECTIONS = 200


@dataclass(frozen=True)
class Surface:
    """The colliding geoms of B links, G per link; links with fewer repeat one."""

    links: Tensor  #: (B,) rows among the layout's links
    centres: Tensor  #: (B, G, 3) m, in the link's frame
    axes: Tensor  #: (B, G, 3, 3) columns are the geom's axes in the link's frame
    boxes: Tensor  #: (B, G, 3) m, half sides
    ellipsoids: Tensor  #: (B, G, 3) m, half axes
    heights: Tensor  #: (B,) m: what to add, :data:`FAR` of a link that cannot touch anything

    def to(self, device: torch.device) -> Surface:
        """The same on another device, in float32."""
        tensors = {name: value.to(device) for name, value in vars(self).items()}
        return replace(
            self, **{k: v.float() if v.is_floating_point() else v for k, v in tensors.items()}
        )


def surface_of(character: Character, links: Sequence[str], layout: Layout) -> Surface:
    """The surface, float64, of the `links` named."""
    model = character.model
    parts: list[list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]] = []
    for name in links:
        body = int(layout.link_bodies[layout.link_names.index(name)])
        own = [g.id for g in character.geoms if int(model.geom_bodyid[g.id]) == body]
        parts.append([piece for geom in own for piece in _pieces(character, geom)])
    most = max(1, *(len(pieces) for pieces in parts))
    nothing = (np.zeros(3), np.eye(3), np.zeros(3), np.zeros(3))
    filled = [[*p, *[p[0] if p else nothing] * (most - len(p))] for p in parts]
    columns = [
        torch.from_numpy(np.array([[piece[i] for piece in row] for row in filled]))
        for i in range(4)
    ]
    return Surface(
        torch.tensor([layout.link_names.index(name) for name in links]),
        *columns,
        heights=torch.tensor([0.0 if pieces else FAR for pieces in parts], dtype=torch.float64),
    )


def _pieces(
    character: Character, geom: int
) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
    """Centre, axes, box and ellipsoid, each in the body's frame, that make up the geom."""
    model, types = character.model, mujoco.mjtGeom
    kind, size = int(model.geom_type[geom]), model.geom_size[geom].copy()
    axes = np.zeros(9)
    mujoco.mju_quat2Mat(axes, model.geom_quat[geom])
    axes, centre, none = axes.reshape(3, 3), model.geom_pos[geom].copy(), np.zeros(3)
    along, across = np.array([0.0, 0.0, size[1]]), np.array([size[0], size[0], 0.0])
    if kind == types.mjGEOM_SPHERE:
        return [(centre, axes, none, np.full(3, size[0]))]
    if kind == types.mjGEOM_CAPSULE:
        return [(centre, axes, along, np.full(3, size[0]))]
    if kind == types.mjGEOM_CYLINDER:
        return [(centre, axes, along, across)]
    if kind == types.mjGEOM_BOX:
        return [(centre, axes, size, none)]
    if kind == types.mjGEOM_ELLIPSOID:
        return [(centre, axes, none, size)]
    if kind == types.mjGEOM_MESH:
        vertices = character.mesh(geom)[0]
        extreme = np.unique((vertices @ _directions().T).argmax(axis=0))
        return [(centre + axes @ vertices[row], axes, none, none) for row in extreme]
    return []


def _directions() -> np.ndarray:
    """(D, 3) unit vectors, evenly spread (a Fibonacci lattice)."""
    k = np.arange(_DIRECTIONS)
    z = 1.0 - (2.0 * k + 1.0) / _DIRECTIONS
    turn, radius = np.pi * (1.0 + np.sqrt(5.0)) * k, np.sqrt(1.0 - z**2)
    return np.stack((radius * np.cos(turn), radius * np.sin(turn), z), axis=1)


def lowest_points(surface: Surface, height: Tensor, up: Tensor) -> Tensor:
    """(N, B) m: how high the lowest point of each link of `surface` is above z = 0.

    Parameters
    ----------
    height
        (N, B) m, of these links' origins.
    up
        (N, B, 3), the world's z axis in their frames.
    """
    along = torch.einsum("nbi,bgij->nbgj", up, surface.axes)
    centre = torch.einsum("nbi,bgi->nbg", up, surface.centres)
    reach = (along.abs() * surface.boxes).sum(-1)
    reach = reach + torch.linalg.vector_norm(along * surface.ellipsoids, dim=-1)
    return height + (centre - reach).amin(dim=2) + surface.heights
