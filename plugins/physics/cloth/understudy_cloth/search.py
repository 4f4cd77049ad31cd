"""What may touch until the next search: shapes by triangles and vertices, and other layers by vertices."""

# What Warp compiles is not quite Python: see solver.py.
# ruff: noqa: UP018, RUF046, SIM102, SIM110

from typing import Any, NamedTuple

import warp as wp

from understudy_cloth.contact import within_shape
from understudy_cloth.memory import Memory
from understudy_cloth.world import Cloth, Features
from understudy_warp_torch.shapes import (
    GRID,
    from_rotation_vector,
    local_distance,
    rotation,
    to_rotation_vector,
    xyz,
)

#: m/s: vertices may become so much faster between two searches for what is near.
_FASTER = wp.constant(1.0)
#: Two layers count as touching, when corrections are averaged, at this part of their thickness.
_CROWDED = wp.constant(1.25)
#: Layers that are nearer than this part of their thickness are seen when what may touch is searched.
SEEN = 1.5


@wp.func
def cell_of(x: wp.vec3, size: float) -> wp.vec3i:
    """The cell of a grid of this `size`, m, in which `x` is."""
    return wp.vec3i(
        int(wp.floor(x[0] / size)), int(wp.floor(x[1] / size)), int(wp.floor(x[2] / size))
    )


@wp.func
def bucket(cell: wp.vec3i, buckets: int) -> int:
    """`buckets` is a power of two."""
    return ((cell[0] * 73856093) ^ (cell[1] * 19349663) ^ (cell[2] * 83492791)) & (buckets - 1)


@wp.func
def shape_way(c: Cloth, world: int, shape: int):
    """How far any of its points may go until the next search."""
    t = c.tools.tool[shape]
    o = 6 * t
    target = wp.vec3(c.control[world, o], c.control[world, o + 1], c.control[world, o + 2])
    turn = wp.vec3(c.control[world, o + 3], c.control[world, o + 4], c.control[world, o + 5])
    q = rotation(c.tools.orientation[world, t])
    angle = wp.length(to_rotation_vector(from_rotation_vector(turn) * wp.quat_inverse(q)))
    arm = wp.length(c.tools.offset[shape]) + wp.length(c.tools.centre[shape]) + c.tools.bound[shape]
    share = wp.min(float(c.every) / float(c.substeps - c.substep[world]), 1.0)
    way = wp.length(target - c.tools.position[world, t]) + angle * arm
    c.way[world, shape] = share * way
    # where it is now, for who looks for what is near before it moves
    place = c.tools.position[world, t] + wp.quat_rotate(q, c.tools.offset[shape])
    q = q * c.tools.turn[shape]
    c.tools.shape_position[world, shape] = place
    c.tools.shape_rotation[world, shape] = q
    c.middle[world, shape] = place + wp.quat_rotate(q, c.tools.centre[shape])


@wp.func
def own_way(c: Cloth, world: int, speed: float) -> float:
    """How far what has a speed now may go until the next search: as fast as the fastest shape may push it."""
    time = float(c.every) * c.dt
    faster = time * _FASTER
    for shape in range(c.tools.shapes):
        faster = wp.max(faster, c.way[world, shape])
    return time * speed + faster


@wp.func
def never_touch(c: Cloth, i: int, j: int) -> bool:
    """Whether the vertices `i` and `j` are left out of self-contact, as neighbours are."""
    for k in range(c.apart_start[i], c.apart_start[i + 1]):
        if c.apart[k] == j:
            return True
    return False


@wp.func
def search_layers(c: Cloth, world: int, i: int):
    """The vertices, nearest first, that vertex i may touch until the next search."""
    o = world * c.vertices
    x = c.anchor[o + i]
    size = wp.static(SEEN) * c.thickness
    found = int(0)
    crowd = float(0.0)
    home = cell_of(x, size)
    for q in range(27):
        cell = home + wp.vec3i(q % 3 - 1, (q / 3) % 3 - 1, q / 9 - 1)
        j = c.head[world * c.buckets + bucket(cell, c.buckets)]
        while j >= 0:
            y = c.anchor[o + j]
            r2 = wp.length_sq(x - y)
            if j != i and r2 < size * size:
                # others of this bucket are met, if near, in their own cell
                if cell_of(y, size) == cell and not never_touch(c, i, j):
                    if r2 < _CROWDED * _CROWDED * c.thickness * c.thickness:
                        crowd += 1.0
                    # where it belongs among those already found; the farthest is left out
                    k = wp.min(found, c.room)
                    while k > 0:
                        other = c.candidate[world, i, k - 1]
                        theirs = wp.length_sq(x - c.anchor[o + other])
                        if theirs < r2 or (theirs == r2 and other < j):
                            break
                        if k < c.room:
                            c.candidate[world, i, k] = other
                        k = k - 1
                    if k < c.room:
                        c.candidate[world, i, k] = j
                    found += 1
            j = c.next[o + j]
    c.candidates[o + i] = wp.min(found, c.room)
    c.crowd[o + i] = 1.0 / wp.max(crowd, 1.0)
    c.left_out[o + i] += wp.max(found - c.room, 0)


@wp.func
def searches(c: Cloth, world: int, resumes: bool) -> bool:
    """Whether a search is due in this sub-step; or, as state is set, whether one is not but its layers are."""
    due = c.substep[world] % c.every == 0
    return due != resumes


class Search(NamedTuple):
    """The phases of a search: (cloth, m, world, item, whether this resumes), in this order."""

    begin: Any  #: of a bucket, vertex or shape
    insert: Any  #: of a vertex or triangle
    search: Any  #: of a vertex


def search_of(features: Features, memory: Memory) -> Search:
    """Of scenes with these `features`, whose positions are in this `memory`."""
    SHAPES = wp.constant(features.shapes)
    LAYERS = wp.constant(features.self_contact)
    load = memory.load

    @wp.func
    def begin_search(c: Cloth, m: wp.uint64, world: int, k: int, resumes: bool):
        """Where vertices and shapes are now, from which all that is searched follows."""
        if wp.static(LAYERS):
            if k < c.vertices and not resumes:
                c.anchor[world * c.vertices + k] = load(m, c, k)
            if k < c.buckets:
                c.head[world * c.buckets + k] = -1
        if wp.static(SHAPES):
            if k < c.tools.shapes and not resumes:
                shape_way(c, world, k)

    @wp.func
    def search_face(c: Cloth, m: wp.uint64, world: int, f: int):
        """The shapes that a triangle may touch until the next search."""
        ends = c.face[f]
        o = world * c.vertices
        v0 = wp.length(c.velocity[o + ends[0]])
        v1 = wp.length(c.velocity[o + ends[1]])
        v2 = wp.length(c.velocity[o + ends[2]])
        reach = c.gap + own_way(c, world, wp.max(v0, wp.max(v1, v2)))
        x0 = load(m, c, ends[0])
        x1 = load(m, c, ends[1])
        x2 = load(m, c, ends[2])
        middle = (x0 + x1 + x2) / 3.0
        x0 = middle - x0
        x1 = middle - x1
        x2 = middle - x2
        size = wp.max(wp.length(x0), wp.max(wp.length(x1), wp.length(x2)))
        bits = int(0)
        for shape in range(c.tools.shapes):
            within = reach + c.way[world, shape]
            apart = wp.length(middle - c.middle[world, shape])
            if apart < c.tools.bound[shape] + within + size:
                p = within_shape(c.tools, world, shape, middle)
                found = local_distance(c.tools, shape, p)
                less = size
                if c.tools.kind[shape] != GRID:  # convex, as in `deepest`
                    n = wp.quat_rotate(c.tools.shape_rotation[world, shape], xyz(found))
                    less = wp.max(wp.dot(x0, n), wp.max(wp.dot(x1, n), wp.dot(x2, n)))
                if found[3] - less < within:
                    bits = bits | (1 << shape)
        c.face_near[world, f] = bits

    @wp.func
    def search_vertex(c: Cloth, m: wp.uint64, world: int, i: int):
        """The same of a vertex, which touches nothing that no triangle of it does."""
        o = world * c.vertices + i
        around = int(0)
        for k in range(c.corner_start[i], c.corner_start[i + 1]):
            around = around | c.face_near[world, c.corner[k] / 3]
        marked = int(0)
        if around != 0:
            x = load(m, c, i)
            reach = c.gap + own_way(c, world, wp.length(c.velocity[o]))
            bits = int(0)
            for shape in range(c.tools.shapes):
                if ((around >> shape) & 1) == 1:
                    p = within_shape(c.tools, world, shape, x)
                    found = local_distance(c.tools, shape, p)
                    if found[3] < reach + c.way[world, shape]:
                        bits = bits | (1 << shape)
            marked = ~bits
        c.near[o] = marked

    @wp.func
    def insert(c: Cloth, m: wp.uint64, world: int, k: int, resumes: bool):
        if wp.static(SHAPES):
            if k < c.faces and not resumes:
                search_face(c, m, world, k)
        if wp.static(LAYERS):
            if k < c.vertices:
                o = world * c.vertices + k
                size = wp.static(SEEN) * c.thickness
                h = bucket(cell_of(c.anchor[o], size), c.buckets)
                c.next[o] = wp.atomic_exch(c.head, world * c.buckets + h, k)

    @wp.func
    def search(c: Cloth, m: wp.uint64, world: int, i: int, resumes: bool):
        if wp.static(SHAPES):
            if not resumes:
                search_vertex(c, m, world, i)
        if wp.static(LAYERS):
            search_layers(c, world, i)

    return Search(begin_search, insert, search)
