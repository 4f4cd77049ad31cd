"""From a mesh of triangles to what the solver works on: constraints in colours, masses, neighbours."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

STRETCH, SHEAR, BENDING = range(3)
#: An edge this much longer than the other edges of its triangles is the diagonal of a quadrilateral.
_DIAGONAL = 1.2
#: Vertices nearer than this along the cloth, in thicknesses, never touch each other.
_APART = 1.6


@dataclass(frozen=True)
class Constraints:
    """C distances |x_i − x_j| = rest, sorted by colour; no two of a colour share a vertex."""

    pairs: np.ndarray  #: (C, 2)
    rest: np.ndarray  #: (C,) m
    unit: np.ndarray  #: (C,) m/N of a fabric with 1 N/m
    first: np.ndarray  #: (K + 1,): colour k has the constraints from first[k] to first[k + 1]
    kind: np.ndarray  #: (K,): STRETCH, SHEAR or BENDING, of all of a colour


def face_areas(corners: np.ndarray) -> np.ndarray:
    """(F,) m², of triangles (F, 3, 2) or (F, 3, 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    squares = (a * a).sum(1) * (b * b).sum(1) - (a * b).sum(1) ** 2
    return 0.5 * np.sqrt(np.maximum(squares, 0.0))


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (E, 2), lower vertex first, and for each (F, 3) the edge from its corner k to k + 1."""
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2)
    edges, index = np.unique(sides.reshape(-1, 2), axis=0, return_inverse=True)
    return edges, index.reshape(-1, 3)


def constraints_of(faces: np.ndarray, corners: np.ndarray) -> Constraints:
    """The constraints of triangles `faces` (F, 3) whose rest shape has the `corners` (F, 3, 2 or 3).

    Edges keep their length; stiffness k = E Σ area / length² over an edge's triangles (Van Gelder 1998,
    Approximate simulation of elastic membranes by triangulated spring meshes, equation 1). Over an edge
    with two triangles, the corners opposite to it keep the distance that they have when both are flat.
    """
    edges, index = edges_of(faces)
    count = len(edges)
    area = face_areas(corners)
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    uses = np.bincount(index.ravel(), minlength=count)
    length = np.bincount(index.ravel(), sides.ravel(), count) / uses
    width = np.bincount(index.ravel(), np.repeat(area, 3), count)
    others = np.maximum(np.roll(sides, 1, axis=1), np.roll(sides, -1, axis=1))
    shorter = np.ones(count, bool)
    np.logical_and.at(shorter, index.ravel(), (sides > _DIAGONAL * others).ravel())
    kind = np.where(shorter & (uses == 2), SHEAR, STRETCH)

    order = np.argsort(index.ravel(), kind="stable")
    shared = np.flatnonzero(np.diff(index.ravel()[order]) == 0)
    one, other = order[shared], order[shared + 1]
    tips = np.stack([faces.ravel()[_opposite(one)], faces.ravel()[_opposite(other)]], axis=1)
    # heights over the common edge, and how far their feet are from each other along it, as if unfolded
    flat = _unfolded(corners, faces, one, other)
    bends = tips[:, 0] != tips[:, 1]
    tips, flat = tips[bends], flat[bends]

    pairs = np.concatenate([edges, np.sort(tips, axis=1)])
    rest = np.concatenate([length, flat])
    unit = np.concatenate([length**2 / np.maximum(width, 1e-12), np.ones(len(tips))])
    kind = np.concatenate([kind, np.full(len(tips), BENDING)])
    colour = np.empty(len(pairs), int)
    colours = 0
    kinds: list[int] = []
    for k in (STRETCH, SHEAR, BENDING):
        these = np.flatnonzero(kind == k)
        if len(these):
            colour[these] = colours + colours_of(pairs[these])
            kinds += [k] * (int(colour[these].max()) + 1 - colours)
            colours = len(kinds)
    order = np.lexsort((pairs[:, 1], pairs[:, 0], colour))
    first = np.concatenate([[0], np.cumsum(np.bincount(colour, minlength=colours))])
    return Constraints(pairs[order], rest[order], unit[order], first, np.array(kinds))


def _opposite(side: np.ndarray) -> np.ndarray:
    """The flat index of the corner opposite to a side, both counted through all triangles."""
    return side - side % 3 + (side % 3 + 2) % 3


def _unfolded(
    corners: np.ndarray, faces: np.ndarray, one: np.ndarray, other: np.ndarray
) -> np.ndarray:
    """Distances of the tips of two triangles that share a side, unfolded into one plane."""
    flat = corners.reshape(-1, corners.shape[2])

    def place(side: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        a, b, tip = flat[side], flat[side - side % 3 + (side % 3 + 1) % 3], flat[_opposite(side)]
        along = b - a
        length = np.maximum(np.linalg.norm(along, axis=1), 1e-12)
        x = ((tip - a) * along).sum(1) / length
        y = np.sqrt(np.maximum(((tip - a) ** 2).sum(1) - x**2, 0.0))
        return x, y, length

    x1, y1, length1 = place(one)
    x2, y2, length2 = place(other)
    same_way = faces.ravel()[one] == faces.ravel()[other]
    x2 = np.where(same_way, x2, length2 - x2)
    return np.hypot(x1 * (length1 + length2) / (2 * length1) - x2, y1 + y2)


def colours_of(pairs: np.ndarray) -> np.ndarray:
    """(C,) greedily: the lowest that neither vertex of a pair has yet."""
    used = [0] * (int(pairs.max()) + 1)
    colours = np.empty(len(pairs), int)
    for n, (i, j) in enumerate(pairs.tolist()):
        taken = used[i] | used[j]
        free = ~taken & (taken + 1)
        colours[n] = free.bit_length() - 1
        used[i] |= free
        used[j] |= free
    return colours


def vertex_areas(faces: np.ndarray, corners: np.ndarray, count: int) -> np.ndarray:
    """(V,) m²: a third of each triangle's."""
    return np.bincount(faces.ravel(), np.repeat(face_areas(corners) / 3, 3), count)


def faces_of_vertices(faces: np.ndarray, count: int) -> tuple[np.ndarray, np.ndarray]:
    """(V + 1,) and (3 F,): vertex i is the corners (3 × face + corner) from start[i] to start[i + 1]."""
    order = np.argsort(faces.ravel(), kind="stable")
    start = np.concatenate([[0], np.cumsum(np.bincount(faces.ravel(), minlength=count))])
    return start, order


def neighbours_along(
    pairs: np.ndarray, lengths: np.ndarray, count: int, thickness: float
) -> tuple[np.ndarray, np.ndarray]:
    """(V + 1,) and (…,): those that vertex i never touches, since they are near along the cloth."""
    graph = csr_array((lengths, (pairs[:, 0], pairs[:, 1])), shape=(count, count))
    start, found = [0], []
    for row in range(0, count, 512):
        rows = np.arange(row, min(row + 512, count))
        far = dijkstra(graph, directed=False, indices=rows, limit=_APART * thickness)
        for line in np.isfinite(far):
            near = np.flatnonzero(line)
            found.append(near)
            start.append(start[-1] + len(near))
    return np.array(start), np.concatenate(found)
