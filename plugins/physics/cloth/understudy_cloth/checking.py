"""What a mesh must be to move as cloth."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components

from understudy.errors import ConfigError, UnderstudyError
from understudy_cloth.mesh import edges_of, face_areas

#: A triangle whose height is below this part of its longest side has no area to speak of.
_FLAT = 1e-4


def check_mesh(
    positions: np.ndarray,
    faces: np.ndarray,
    what: str,
    error: type[UnderstudyError] = ConfigError,
    loose: bool = False,
) -> None:
    """Refuse what is no surface of triangles with two sides: `positions` (V, 3), `faces` (F, 3). With `loose` there may
    be vertices in no triangle.

    Raises
    ------
    UnderstudyError
        of the kind `error`, one sentence that begins with `what` and names the worst place.
    """
    if positions.ndim != 2 or positions.shape[1] != 3 or not np.isfinite(positions).all():
        raise error(f"{what} needs (V, 3) finite coordinates.")
    if faces.ndim != 2 or faces.shape[1] != 3 or not len(faces):
        raise error(f"{what} needs (F, 3) triangles, at least one.")
    if ((faces < 0) | (faces >= len(positions))).any():
        raise error(f"{what} has a triangle of vertices that do not exist.")
    corners = positions[faces]
    longest = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2).max(axis=1)
    flat = np.flatnonzero(2 * face_areas(corners) <= _FLAT * longest**2)
    if len(flat):
        raise error(
            f"{what} has {_count(len(flat), 'triangle')} without area, the first is number {flat[0]}: "
            "remove such triangles, or merge their vertices."
        )
    ordered = np.sort(faces, axis=1)
    kinds, counts = np.unique(ordered, axis=0, return_counts=True)
    if (counts > 1).any():
        a, b, c = kinds[counts > 1][0]
        raise error(
            f"{what} has {_count(int((counts > 1).sum()), 'triangle')} more than once, the first of "
            f"vertices {a}, {b} and {c}: keep one of each."
        )
    edges, index = edges_of(faces)
    uses = np.bincount(index.ravel())
    if (uses > 2).any():
        i, j = edges[uses > 2][0]
        raise error(
            f"{what} is not manifold: {_count(int((uses > 2).sum()), 'edge')} in more than two triangles, "
            f"the first from vertex {i} to {j}; cut the mesh there."
        )
    # a side that both of its triangles go along the same way
    ways = np.bincount(index.ravel(), np.where(faces < np.roll(faces, -1, axis=1), 1, -1).ravel())
    flipped = (uses == 2) & (ways != 0)
    if flipped.any():
        i, j = edges[flipped][0]
        raise error(
            f"{what} has triangles that face opposite ways, at {_count(int(flipped.sum()), 'edge')}, the "
            f"first from vertex {i} to {j}: let all be counter-clockwise seen from outside."
        )
    used = np.bincount(faces.ravel(), minlength=len(positions))
    if (used == 0).any() and not loose:
        raise error(
            f"{what} has {_count(int((used == 0).sum()), 'vertex', 'vertices')} in no triangle, the first is "
            f"number {np.argmin(used)}: remove them."
        )
    pinched = pinched_vertices(faces, len(positions))
    if len(pinched):
        raise error(
            f"{what} is not manifold: {_count(len(pinched), 'vertex', 'vertices')} where parts touch in a "
            f"point alone, the first is number {pinched[0]}; double it."
        )


def pinched_vertices(faces: np.ndarray, count: int) -> np.ndarray:
    """Vertices whose triangles are not all reached from each other through edges at the vertex."""
    _, index = edges_of(faces)
    # a node for each corner; corners of one vertex in two triangles that share an edge there belong together
    order = np.argsort(index.ravel(), kind="stable")
    shared = np.flatnonzero(np.diff(index.ravel()[order]) == 0)
    one, other = order[shared], order[shared + 1]
    corners = faces.ravel()

    def ends(side: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return side, side - side % 3 + (side % 3 + 1) % 3

    links = []
    for a in ends(one):
        for b in ends(other):
            same = corners[a] == corners[b]
            links.append(np.stack([a[same], b[same]]))
    pairs = np.concatenate(links, axis=1)
    graph = coo_array(
        (np.ones(pairs.shape[1]), (pairs[0], pairs[1])), shape=(len(corners), len(corners))
    )
    _, label = connected_components(graph, directed=False)
    fans = np.unique(np.stack([corners, label]), axis=1)
    return np.flatnonzero(np.bincount(fans[0], minlength=count) > 1)


def pieces_of(faces: np.ndarray, count: int) -> int:
    """How many parts the mesh has that no edge joins."""
    edges, _ = edges_of(faces)
    graph = coo_array((np.ones(len(edges)), (edges[:, 0], edges[:, 1])), shape=(count, count))
    return int(connected_components(graph, directed=False)[0])


def _count(number: int, singular: str, plural: str | None = None) -> str:
    return f"{number} {singular if number == 1 else plural or singular + 's'}"
