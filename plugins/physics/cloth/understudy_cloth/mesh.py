"""From a mesh of triangles to what the solver works on: constraints in colours, masses, neighbours."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import lru_cache, wraps
from typing import TypeVar

import numpy as np
from scipy.sparse import csr_array
from scipy.sparse.csgraph import dijkstra

__all__ = ["edges_of", "face_areas"]

STRETCH, SHEAR, BENDING = range(3)
#: Vertices whose positions fit into the shared memory of a block: 46 of 48 KiB, of which Warp takes one.
SHARED_VERTICES = 3920
#: And with their weights beside them: 16 bytes each, which a thread reads at once.
WEIGHTED_VERTICES = 2944
#: Threads that a GPU serves at once where each reads 16 bytes, and banks of so many.
_BANKS = 8
_NEVER = 1 << 40  #: a cost beyond all
#: An edge this much longer than the other edges of its triangles is the diagonal of a quadrilateral.
_DIAGONAL = 1.2
#: Vertices nearer than this along the cloth, in thicknesses, never touch each other.
_APART = 1.6

T = TypeVar("T", "Distances", "Hinges")


def once_each(
    find: Callable[[np.ndarray, np.ndarray, bool], T],
) -> Callable[[np.ndarray, np.ndarray, bool], T]:
    """`find`, of triangles (F, 3) and their corners, worked out once for those last asked for: training, evaluation and
    settling ask for the same garment. What it returns cannot be written to."""

    @lru_cache(maxsize=8)
    def found(threads: bool, *arrays: tuple[bytes, np.dtype, tuple[int, ...]]) -> T:
        faces, corners = (np.frombuffer(b, dtype).reshape(shape) for b, dtype, shape in arrays)
        result = find(faces, corners, threads)
        for array in vars(result).values():
            array.setflags(write=False)
        return result

    @wraps(find)
    def asked(faces: np.ndarray, corners: np.ndarray, threads: bool) -> T:
        return found(threads, *((a.tobytes(), a.dtype, a.shape) for a in (faces, corners)))

    return asked


@dataclass(frozen=True)
class Distances:
    """C edges, |x_i − x_j| = rest, sorted by colour; no two of a colour share a vertex."""

    pairs: np.ndarray  #: (C, 2)
    rest: np.ndarray  #: (C,) m
    unit: np.ndarray  #: (C,) compliance, m/N, of a fabric with 1 N/m
    first: np.ndarray  #: (K + 1,): colour k has the edges from first[k] to first[k + 1]
    kind: np.ndarray  #: (K,): STRETCH or SHEAR, of all of a colour


@dataclass(frozen=True)
class Hinges:
    """H pairs of triangles with a common edge, Σ weight_i x_i = 0 when flat, sorted by colour."""

    quads: np.ndarray  #: (H, 4): the edge's ends, then the two tips
    weights: np.ndarray  #: (H, 4)
    unit: np.ndarray  #: (H,) compliance, m/N, of a fabric with 1 N m
    first: np.ndarray  #: (K + 1,)


def face_areas(corners: np.ndarray) -> np.ndarray:
    """(F,) m², of triangles (F, 3, 2) or (F, 3, 3)."""
    a, b = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    squares = (a * a).sum(1) * (b * b).sum(1) - (a * b).sum(1) ** 2
    return 0.5 * np.sqrt(np.maximum(squares, 0.0))


def edges_of(faces: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The edges (E, 2), lower vertex first, and for each (F, 3) the edge from its corner k to k + 1."""
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=2), axis=2)
    count = int(faces.max(initial=0)) + 1
    numbers = sides[..., 0].astype(np.int64) * count + sides[..., 1]  # of one column: sorted sooner
    found, index = np.unique(numbers, return_inverse=True)
    edges = np.stack(np.divmod(found, count), axis=1).astype(faces.dtype)
    return edges, index.reshape(-1, 3)


@once_each
def distances_of(faces: np.ndarray, corners: np.ndarray, threads: bool) -> Distances:
    """The edges of triangles `faces` (F, 3) whose rest shape has the `corners` (F, 3, 2 or 3).

    Stiffness is k = E Σ area / length² over an edge's triangles (Van Gelder 1998, Approximate simulation of
    elastic membranes by triangulated spring meshes, equation 1). Those of a colour are spread where `threads` go
    through them side by side.
    """
    edges, index = edges_of(faces)
    count = len(edges)
    sides = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    uses = np.bincount(index.ravel(), minlength=count)
    length = np.bincount(index.ravel(), sides.ravel(), count) / uses
    area = np.bincount(index.ravel(), np.repeat(face_areas(corners), 3), count)
    others = np.maximum(np.roll(sides, 1, axis=1), np.roll(sides, -1, axis=1))
    longest = np.ones(count, bool)
    np.logical_and.at(longest, index.ravel(), (sides > _DIAGONAL * others).ravel())
    shears = longest & (uses == 2)
    unit = length**2 / np.maximum(area, 1e-12)
    colour = np.empty(count, int)
    kinds: list[int] = []
    for kind, these in ((STRETCH, np.flatnonzero(~shears)), (SHEAR, np.flatnonzero(shears))):
        if len(these):
            colour[these] = len(kinds) + colours_of(edges[these])
            kinds += [kind] * (int(colour[these].max()) + 1 - len(kinds))
    order = np.lexsort((edges[:, 1], edges[:, 0], colour))
    if threads:
        order = spread(order, colour, edges)
    first = np.concatenate([[0], np.cumsum(np.bincount(colour, minlength=len(kinds)))])
    return Distances(edges[order], length[order], unit[order], first, np.array(kinds))


@once_each
def hinges_of(faces: np.ndarray, corners: np.ndarray, threads: bool) -> Hinges:
    """The edges with two triangles, and how each resists bending: E = ½ B / (A_1 + A_2) |Σ weight_i x_i|²,
    quadratic, for cloth that is flat at rest and hardly stretches (Bergou et al. 2006, A quadratic bending
    model for inextensible surfaces, section 3). They have 3 B: with B a cylinder has the energy
    ½ B κ² an area on meshes of equal triangles, whatever its axis, and on grids along their axes. Those of a colour
    are spread where `threads` go through them side by side."""
    _, index = edges_of(faces)
    order = np.argsort(index.ravel(), kind="stable")
    shared = np.flatnonzero(np.diff(index.ravel()[order]) == 0)
    one, other = order[shared], order[shared + 1]
    vertex, place = faces.ravel(), corners.reshape(-1, corners.shape[2])
    quads = np.stack(
        [vertex[one], vertex[_next(one)], vertex[_tip(one)], vertex[_tip(other)]], axis=1
    )
    at_first, at_second, areas = np.zeros(len(one)), np.zeros(len(one)), np.zeros(len(one))
    tips = []
    for side in (one, other):
        begins = vertex[side] == quads[:, 0]  # else the triangle goes along the edge the other way
        a = place[np.where(begins, side, _next(side))]
        b = place[np.where(begins, _next(side), side)]
        tip = place[_tip(side)]
        double = 2 * face_areas(np.stack([a, b, tip], axis=1))
        cot_a = ((b - a) * (tip - a)).sum(1) / double
        cot_b = ((a - b) * (tip - b)).sum(1) / double
        at_first += cot_b
        at_second += cot_a
        tips.append(-cot_a - cot_b)
        areas += 0.5 * double
    weights = np.stack([at_first, at_second, *tips], axis=1)
    if not len(quads):
        return Hinges(quads, weights, areas, np.zeros(1, int))
    colour = even_out(colours_of(quads), quads)
    order = np.lexsort((quads[:, 0], colour))
    if threads:
        order = spread(order, colour, quads)
    first = np.concatenate([[0], np.cumsum(np.bincount(colour))])
    return Hinges(quads[order], weights[order], areas[order], first)


def _next(side: np.ndarray) -> np.ndarray:
    """The flat index of the corner where a side ends, both counted through all triangles."""
    return side - side % 3 + (side % 3 + 1) % 3


def _tip(side: np.ndarray) -> np.ndarray:
    """Of the corner opposite to a side."""
    return side - side % 3 + (side % 3 + 2) % 3


def colours_of(groups: np.ndarray) -> np.ndarray:
    """(C,) greedily: the lowest that no vertex of a group (C, n) has yet."""
    used = [0] * (int(groups.max()) + 1)
    colours = np.empty(len(groups), int)
    for number, group in enumerate(groups.tolist()):
        taken = 0
        for vertex in group:
            taken |= used[vertex]
        free = ~taken & (taken + 1)
        colours[number] = free.bit_length() - 1
        for vertex in group:
            used[vertex] |= free
    return colours


def even_out(colours: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """(C,) the colours of :func:`colours_of`, of which each has as nearly as many groups as a sweep attains:
    what is too many in one goes to the least used that is free. So no few are left for the last threads."""
    colours, size = colours.copy(), np.bincount(colours)
    most = -(-len(groups) // len(size))
    used = [0] * (int(groups.max()) + 1)
    for group, colour in zip(groups.tolist(), colours.tolist(), strict=True):
        for vertex in group:
            used[vertex] |= 1 << colour
    for number, group in enumerate(groups.tolist()):
        old = int(colours[number])
        if size[old] > most:
            taken = 0
            for vertex in group:
                taken |= used[vertex]
            new = min(range(len(size)), key=lambda k: size[k] + (taken >> k & 1) * len(groups))
            if size[new] < most and not taken >> new & 1:
                colours[number] = new
                size[old], size[new] = size[old] - 1, size[new] + 1
                for vertex in group:
                    used[vertex] ^= 1 << old | 1 << new
    return colours


def spread(order: np.ndarray, colours: np.ndarray, groups: np.ndarray) -> np.ndarray:
    """(C,) the same `order` by colours, within each so changed that threads side by side meet in as few banks of
    shared memory as a greedy choice attains: a GPU reads 16 bytes for 8 threads at once if no two of their
    vertices are the same modulo 8. Within a colour no vertex is another's, so the order changes no result."""
    found = np.empty_like(order)
    columns = groups.shape[1]
    bank = groups % _BANKS + _BANKS * np.arange(columns)  # of all columns' banks, counted through
    done = 0
    for count in np.bincount(colours):
        left = order[done : done + count]
        banks, met = bank[left], np.zeros((columns, _BANKS), int)
        taken = np.zeros(count, int)
        for place in range(count):
            if place % _BANKS == 0:
                met[:] = 0
                keep = np.flatnonzero(taken == 0)
                left, banks, taken = left[keep], banks[keep], taken[keep]
            # what each would add to the most that meet in a bank, by columns
            adds = np.maximum(met + 1 - met.max(axis=1, keepdims=True), 0) * 64 + met
            cost = adds.ravel()[banks].sum(axis=1) + taken
            best = int(cost.argmin())
            found[done + place] = left[best]
            met.ravel()[banks[best]] += 1
            taken[best] = _NEVER
        done += count
    return found


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
