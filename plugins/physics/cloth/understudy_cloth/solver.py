"""Cloth by extended position-based dynamics in small steps, N worlds: the phases of a sub-step, and two
ways to go through them.

Each phase is a function of one vertex, constraint or triangle of one world. :func:`build_kernels`
makes of them

- ``block``: one kernel for any number of sub-steps, a thread block for each world. Positions stay in
  shared memory if they fit. On the CPU a block has one thread.
- one kernel for each phase and colour with a thread for each of its items, the same numbers by launches.

No result depends on the order of threads: constraints of a colour share no vertex, and everything else
reads others and writes its own.
"""

# What Warp compiles is not quite Python: variables that loops change are made with float(0.0), and
# conditions known when compiling stand alone.
# ruff: noqa: UP018, RUF046, SIM102, SIM110
# pyright: reportInvalidTypeForm=false, reportGeneralTypeIssues=false, reportArgumentType=false
# pyright: reportAssignmentType=false, reportOperatorIssue=false, reportReturnType=false
# pyright: reportCallIssue=false, reportIndexIssue=false, reportAttributeAccessIssue=false

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from understudy_cloth import mesh
from understudy_warp_torch.blocks import global_memory as global_address
from understudy_warp_torch.blocks import load_row, shared_memory, store_row, wait_for_block
from understudy_warp_torch.shapes import (
    GRID,
    Tools,
    advance_tools,
    friction,
    from_rotation_vector,
    local_distance,
    place_shapes,
    rotation,
    to_rotation_vector,
    xyz,
)

#: Column of the fabric's stiffness.
BENDING = wp.constant(mesh.BENDING)
#: Shapes that a scene may have: bits of a number.
MOST_SHAPES = 31
#: Nearer than this points have no direction from each other, m.
_NEAR = wp.constant(1e-9)
#: How often the point of a triangle that is deepest in a shape is improved.
_SEARCHES = wp.constant(3)
#: m: that point is found when no other of the triangle can be deeper by more than this.
_DECIDED = wp.constant(2e-5)
#: How often a vertex is pushed out of bodies that push it into each other.
_WEDGED = wp.constant(4)
#: m/s: vertices may become so much faster between two searches for what is near.
_FASTER = wp.constant(1.0)
#: Two layers count as touching, when corrections are averaged, at this part of their thickness.
_CROWDED = wp.constant(1.25)
#: Layers that are nearer than this part of their thickness are seen when what may touch is searched.
SEEN = 1.5

#: Division and roots to 2 bits less, on CUDA.
_FAST = {"fast_math": True}


@wp.struct
class Cloth:
    """What kernels are handed. N worlds, V vertices, F triangles, K colours of edges and L of hinges, M
    candidates, U vertices of grips. Arrays of vertices are (N · V,)."""

    # the state
    position: wp.array(dtype=wp.vec3)
    velocity: wp.array(dtype=wp.vec3)
    force: wp.array(dtype=wp.vec3)
    side: wp.array(dtype=float)
    anchor: wp.array(dtype=wp.vec3)  # positions when what may touch was last searched
    # bits of the shapes that were near then: of a triangle, or ~bits while it touches one, (N, F); of a
    # vertex ~bits, or 0 if none is near a triangle of it
    face_near: wp.array2d(dtype=int)
    near: wp.array(dtype=int)
    substep: wp.array(dtype=int)  # done in the present control period, (N,)
    closed: wp.array2d(dtype=float)  # (N, G)
    holder: wp.array2d(dtype=int)  # the grip that holds, −1: none, (N, U)
    held_at: wp.array2d(dtype=wp.vec3)  # in the frame of the grip's tool, (N, U)
    tools: Tools
    control: wp.array2d(dtype=float)
    # the mesh
    vertices: int
    faces: int
    pair: wp.array(dtype=wp.vec2i)
    rest: wp.array(dtype=float)
    unit: wp.array(dtype=float)
    first: wp.array(dtype=int)  # (K + 1,)
    kind: wp.array(dtype=int)  # (K,)
    colours: int  # K
    quad: wp.array(dtype=wp.vec4i)
    quad_weight: wp.array(dtype=wp.vec4)
    quad_unit: wp.array(dtype=float)
    quad_first: wp.array(dtype=int)  # (L + 1,)
    quad_colours: int  # L
    inverse_area: wp.array(dtype=float)  # 1/m², 0: pinned
    face: wp.array(dtype=wp.vec3i)
    corner_start: wp.array(dtype=int)  # (V + 1,)
    corner: wp.array(dtype=int)  # (3 F,)
    grips: int
    grip_vertices: int  # U
    grip_tool: wp.array(dtype=int)
    grip_vertex: wp.array(dtype=int)
    grip_holds: wp.array2d(dtype=int)  # (U, G)
    # worlds may differ in these
    gravity: wp.array(dtype=wp.vec3)
    friction: wp.array(dtype=float)
    density: wp.array(dtype=float)
    stiffness: wp.array2d(dtype=float)  # (N, 3)
    # the fabric
    damping: float
    gap: float
    # self-contact
    thickness: float
    room: int  # M
    buckets: int  # a power of 2
    apart_start: wp.array(dtype=int)
    apart: wp.array(dtype=int)
    # solver
    dt: float
    substeps: int
    every: int  # sub-steps between searches
    bending_every: int  # sub-steps from one sweep over hinges to the next
    # working memory
    weight: wp.array(dtype=float)  # 1 / area, 0: held or pinned
    start: wp.array(dtype=wp.vec3)
    way: wp.array2d(dtype=float)  # how far a shape may go until the next search, (N, S)
    middle: wp.array2d(dtype=wp.vec3)  # of the sphere around a shape at the search, (N, S)
    corner_push: wp.array(dtype=wp.vec4)  # and its weight, (N · 3 F,)
    corner_shift: wp.array(dtype=wp.vec3)
    head: wp.array(dtype=int)  # (N · buckets,)
    next: wp.array(dtype=int)
    candidate: wp.array3d(dtype=int)  # (N, V, M)
    candidates: wp.array(dtype=int)
    crowd: wp.array(dtype=float)  # 1 / layers that touch
    push: wp.array(dtype=wp.vec3)
    shift: wp.array(dtype=wp.vec3)
    left_out: wp.array(dtype=int)  # candidates for which there was no room, so far


@dataclass(frozen=True)
class Features:
    """What the kernels of a scene can do, known when they are compiled."""

    shapes: bool
    grips: bool
    self_contact: bool
    shared: int  #: vertices that shared memory has room for; 0: positions are not there
    weighted: bool  #: whether weights are beside them there
    threads: int  #: of a block


@dataclass(frozen=True)
class Kernels:
    """What is launched, each with its arguments and its number of threads."""

    block: Any  #: (cloth, sub-steps), tiled by worlds
    #: (cloth, whether this resumes), (N, buckets, vertices or shapes, whichever is most)
    begin: Any
    insert: Any  #: (cloth, whether this resumes), (N, V or F)
    search: Any  #: (cloth, whether this resumes), (N, V)
    tools: Any  #: (cloth,), N
    grip: Any  #: (cloth,), (N, U)
    predict: Any  #: (cloth,), (N, V)
    edges: Any  #: (cloth, colour, its first edge), (N, edges)
    hinges: Any  #: (cloth, colour, its first hinge), (N, hinges)
    find_layers: Any  #: (cloth,), (N, V)
    part_layers: Any  #: (cloth,), (N, V)
    touch: Any  #: (cloth,), (N, F)
    finish: Any  #: (cloth,), (N, V)
    count: Any  #: (cloth,), N
    judge: Any  #: (cloth,), (N, V)


packed_address = global_address(wp.vec3)


@wp.func_native("return ((const wp::vec_t<3, float>*)memory)[i];")
def load_packed(memory: wp.uint64, i: int) -> wp.vec3:
    """Vector `i` of those that lie one after the other."""


@wp.func_native("((wp::vec_t<3, float>*)memory)[i] = x;")
def store_packed(memory: wp.uint64, i: int, x: wp.vec3):
    """Write vector `i` of those that lie one after the other."""


# x, y and z apart, so that threads side by side read numbers side by side
@wp.func_native(
    """
    const float* of = (const float*)memory;
    return wp::vec_t<3, float>(of[i], of[n + i], of[2 * n + i]);
"""
)
def load_apart(memory: wp.uint64, n: int, i: int) -> wp.vec3:
    """Vector `i` of `n` whose x, y and z lie apart."""


@wp.func_native(
    """
    float* of = (float*)memory;
    of[i] = x[0];
    of[n + i] = x[1];
    of[2 * n + i] = x[2];
"""
)
def store_apart(memory: wp.uint64, n: int, i: int, x: wp.vec3):
    """Write vector `i` of `n` whose x, y and z lie apart."""


# of a vector and its weight, which are a row of blocks.load_row, the first three or the last
@wp.func_native(
    """
    float* of = (float*)memory + 4 * i;
    of[0] = x[0];
    of[1] = x[1];
    of[2] = x[2];
"""
)
def store_beside(memory: wp.uint64, i: int, x: wp.vec3):
    """Write vector `i`, not its weight."""


@wp.func_native("((float*)memory)[4 * i + 3] = weight;")
def store_weight(memory: wp.uint64, i: int, weight: float):
    """Write the weight of vector `i` alone."""


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
def nearest_in_triangle(p: wp.vec3, a: wp.vec3, b: wp.vec3, c: wp.vec3) -> wp.vec3:
    """Barycentric coordinates of the point nearest to p (Ericson 2005, Real-time collision detection, 5.1.5)."""
    ab = b - a
    ac = c - a
    ap = p - a
    d1 = wp.dot(ab, ap)
    d2 = wp.dot(ac, ap)
    if d1 <= 0.0 and d2 <= 0.0:
        return wp.vec3(1.0, 0.0, 0.0)
    bp = p - b
    d3 = wp.dot(ab, bp)
    d4 = wp.dot(ac, bp)
    if d3 >= 0.0 and d4 <= d3:
        return wp.vec3(0.0, 1.0, 0.0)
    vc = d1 * d4 - d3 * d2
    if vc <= 0.0 and d1 >= 0.0 and d3 <= 0.0:
        v = d1 / wp.max(d1 - d3, 1e-20)
        return wp.vec3(1.0 - v, v, 0.0)
    cp = p - c
    d5 = wp.dot(ab, cp)
    d6 = wp.dot(ac, cp)
    if d6 >= 0.0 and d5 <= d6:
        return wp.vec3(0.0, 0.0, 1.0)
    vb = d5 * d2 - d1 * d6
    if vb <= 0.0 and d2 >= 0.0 and d6 <= 0.0:
        w = d2 / wp.max(d2 - d6, 1e-20)
        return wp.vec3(1.0 - w, 0.0, w)
    va = d3 * d6 - d5 * d4
    if va <= 0.0 and d4 - d3 >= 0.0 and d5 - d6 >= 0.0:
        w = (d4 - d3) / wp.max((d4 - d3) + (d5 - d6), 1e-20)
        return wp.vec3(0.0, 1.0 - w, w)
    total = wp.max(va + vb + vc, 1e-20)
    return wp.vec3(va / total, vb / total, vc / total)


@wp.func
def excess(before: float, change: float) -> float:
    """How far a push of `change` along its normal would throw off what moved by `before` along it in the
    sub-step: a contact ends an approach, and gives no speed away from it."""
    return wp.max(before + change - wp.max(before, 0.0), 0.0)


@wp.func
def within_shape(tools: Tools, world: int, shape: int, x: wp.vec3) -> wp.vec3:
    """The point x of a world in the frame of a shape."""
    return wp.quat_rotate_inv(
        tools.shape_rotation[world, shape], x - tools.shape_position[world, shape]
    )


@wp.func
def carried(tools: Tools, world: int, shape: int, p: wp.vec3) -> wp.vec3:
    """Where the point p of a shape, in its frame, was in the world when the sub-step began."""
    return tools.shape_position_before[world, shape] + wp.quat_rotate(
        tools.shape_rotation_before[world, shape], p
    )


@wp.func
def deepest(tools: Tools, shape: int, p0: wp.vec3, p1: wp.vec3, p2: wp.vec3, gap: float):
    """Where the triangle, in the frame of a shape, is deepest in it: barycentric coordinates, and the
    outward normal and signed distance there. If it is nowhere nearer than `gap`, some point of it."""
    share = wp.vec3(1.0 / 3.0, 1.0 / 3.0, 1.0 / 3.0)
    found = wp.vec4()
    searched = int(0)
    while searched <= _SEARCHES:
        at = share[0] * p0 + share[1] * p1 + share[2] * p2
        found = local_distance(tools, shape, at)
        n = xyz(found)
        # a convex shape's distance is convex: nowhere is it less than along its slope here
        less = wp.max(wp.dot(at - p0, n), wp.max(wp.dot(at - p1, n), wp.dot(at - p2, n)))
        if tools.kind[shape] == GRID:
            less = wp.max(wp.length(p0 - at), wp.max(wp.length(p1 - at), wp.length(p2 - at)))
        if searched == _SEARCHES or less < _DECIDED or found[3] - less >= gap:
            break
        # towards the middle of the shape: from there, what is nearest is deepest
        inner = at - (found[3] + tools.core[shape]) * n
        share = nearest_in_triangle(inner, p0, p1, p2)
        searched += 1
    return share, found


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


@functools.cache
def build_kernels(features: Features) -> Kernels:
    """The kernels of all scenes with these `features`."""
    SHAPES = wp.constant(features.shapes)
    GRIPS = wp.constant(features.grips)
    LAYERS = wp.constant(features.self_contact)
    SHARED = wp.constant(features.shared > 0)
    WEIGHTED = wp.constant(features.weighted)
    LANES = features.threads
    address = packed_address
    if features.weighted:
        address = shared_memory(wp.vec3, "float4", features.shared)
    elif features.shared:
        address = shared_memory(wp.vec3, "float", 3 * features.shared)

    @wp.func
    def load(m: wp.uint64, c: Cloth, i: int) -> wp.vec3:
        x = wp.vec3()
        if wp.static(WEIGHTED):
            x = xyz(load_row(m, i))
        elif wp.static(SHARED):
            x = load_apart(m, c.vertices, i)
        else:
            x = load_packed(m, i)
        return x

    @wp.func
    def store(m: wp.uint64, c: Cloth, i: int, x: wp.vec3):
        if wp.static(WEIGHTED):
            store_beside(m, i, x)
        elif wp.static(SHARED):
            store_apart(m, c.vertices, i, x)
        else:
            store_packed(m, i, x)

    @wp.func
    def load_all(m: wp.uint64, c: Cloth, world: int, i: int) -> wp.vec4:
        """Position and weight."""
        x = wp.vec4()
        if wp.static(WEIGHTED):
            x = load_row(m, i)
        else:
            y = load(m, c, i)
            x = wp.vec4(y[0], y[1], y[2], c.weight[world * c.vertices + i])
        return x

    @wp.func
    def store_all(m: wp.uint64, c: Cloth, i: int, x: wp.vec3, weight: float):
        """The weight is as it was."""
        if wp.static(WEIGHTED):
            store_row(m, i, wp.vec4(x[0], x[1], x[2], weight))
        else:
            store(m, c, i, x)

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

    @wp.func
    def grip(c: Cloth, m: wp.uint64, world: int, u: int):
        """What holds this vertex, and where it is then."""
        i = c.grip_vertex[u]
        o = world * c.vertices + i
        base = 6 * c.tools.tools
        held = c.holder[world, u]
        now = int(-1)
        if held >= 0:
            if c.control[world, base + held] > 0.5:
                now = held
        for g in range(c.grips):
            if now < 0 and c.grip_holds[u, g] == 1 and c.control[world, base + g] > 0.5:
                now = g
        x = load(m, c, i)
        if now >= 0:
            t = c.grip_tool[now]
            if now != held:
                q = rotation(c.tools.orientation_before[world, t])
                c.held_at[world, u] = wp.quat_rotate_inv(q, x - c.tools.position_before[world, t])
            q = rotation(c.tools.orientation[world, t])
            y = c.tools.position[world, t] + wp.quat_rotate(q, c.held_at[world, u])
            c.start[o] = x
            c.velocity[o] = (y - x) / c.dt
            store(m, c, i, y)
        c.holder[world, u] = now
        weight = wp.where(now >= 0, 0.0, c.inverse_area[i])
        c.weight[o] = weight
        if wp.static(WEIGHTED):
            store_weight(m, i, weight)

    @wp.func
    def predict(c: Cloth, m: wp.uint64, world: int, i: int):
        o = world * c.vertices + i
        if c.substep[world] == 0:
            c.force[o] = wp.vec3(0.0)
        x = load(m, c, i)
        if c.weight[o] > 0.0:
            c.start[o] = x
            v = (c.velocity[o] + c.dt * c.gravity[world]) / (1.0 + c.dt * c.damping)
            store(m, c, i, x + c.dt * v)
        elif c.inverse_area[i] == 0.0:
            c.start[o] = x
            c.velocity[o] = wp.vec3(0.0)

    @wp.func
    def softness(c: Cloth, world: int, kind: int) -> float:
        """Of a constraint with 1 m/N, over that of a vertex with 1 m²: ρ / (k Δt²)."""
        k = wp.max(c.stiffness[world, kind], 1e-12)
        return c.density[world] / (k * c.dt * c.dt)

    @wp.func
    def bending_substeps(c: Cloth, world: int) -> int:
        """For how many sub-steps hinges act in this one, 0: in none. What they do at once then is what they
        would do to the speed in all of them."""
        s = c.substep[world]
        return wp.where(s % c.bending_every == 0, wp.min(c.bending_every, c.substeps - s), 0)

    @wp.func
    def keep_distance(c: Cloth, m: wp.uint64, world: int, k: int, soft: float):
        """XPBD with one iteration (Macklin et al. 2016, equation 18, with λ = 0), masses over density."""
        ends = c.pair[k]
        i = load_all(m, c, world, ends[0])
        j = load_all(m, c, world, ends[1])
        wi = i[3]
        wj = j[3]
        apart = xyz(i) - xyz(j)
        length = wp.length(apart)
        if length > _NEAR and wi + wj > 0.0:
            share = (c.rest[k] - length) / (length * (wi + wj + soft * c.unit[k]))
            store_all(m, c, ends[0], xyz(i) + (share * wi) * apart, wi)
            store_all(m, c, ends[1], xyz(j) - (share * wj) * apart, wj)

    @wp.func
    def keep_flat(c: Cloth, m: wp.uint64, world: int, k: int, soft: float):
        """The same for the vector Σ weight_i x_i = 0, whose three components are apart."""
        ends = c.quad[k]
        a = c.quad_weight[k]
        x0 = load_all(m, c, world, ends[0])
        x1 = load_all(m, c, world, ends[1])
        x2 = load_all(m, c, world, ends[2])
        x3 = load_all(m, c, world, ends[3])
        w0 = x0[3] * a[0]
        w1 = x1[3] * a[1]
        w2 = x2[3] * a[2]
        w3 = x3[3] * a[3]
        total = w0 * a[0] + w1 * a[1] + w2 * a[2] + w3 * a[3] + soft * c.quad_unit[k]
        change = xyz(a[0] * x0 + a[1] * x1 + a[2] * x2 + a[3] * x3) / (-total)
        store_all(m, c, ends[0], xyz(x0) + w0 * change, x0[3])
        store_all(m, c, ends[1], xyz(x1) + w1 * change, x1[3])
        store_all(m, c, ends[2], xyz(x2) + w2 * change, x2[3])
        store_all(m, c, ends[3], xyz(x3) + w3 * change, x3[3])

    @wp.func
    def find_layers(c: Cloth, m: wp.uint64, world: int, i: int):
        """How other layers push vertex i, and rub on it."""
        o = world * c.vertices
        count = c.candidates[o + i]
        wi = c.weight[o + i]
        push = wp.vec3(0.0)
        shift = wp.vec3(0.0)
        if count > 0 and wi > 0.0:
            x = load(m, c, i)
            moved = x - c.start[o + i]
            rub = wp.vec3(0.0)
            others = wp.vec3(0.0)
            total = float(0.0)
            for k in range(count):
                j = c.candidate[world, i, k]
                y = load(m, c, j)
                apart = x - y
                r = wp.length(apart)
                if r < c.thickness:
                    if r < _NEAR:  # on each other: apart along z, each its own way
                        r = _NEAR
                        apart = wp.vec3(0.0, 0.0, wp.where(i < j, -_NEAR, _NEAR))
                    n = apart / r
                    share = wp.min(c.crowd[o + i], c.crowd[o + j]) * wi / (wi + c.weight[o + j])
                    theirs = y - c.start[o + j]
                    slip = moved - theirs
                    slip = slip - wp.dot(slip, n) * n
                    depth = c.thickness - r
                    mu = c.friction[world]
                    push += (share * depth) * n
                    rub += share * friction(slip, depth, mu, mu)
                    others += share * theirs
                    total += share
            if total > 0.0:
                size = wp.length(push)
                n = push / wp.max(size, _NEAR)
                before = wp.dot(moved - others / total, n)
                shift = excess(before, size) * n
                push = push - rub
        c.push[o + i] = push
        c.shift[o + i] = shift

    @wp.func
    def part_layers(c: Cloth, m: wp.uint64, world: int, i: int):
        o = world * c.vertices + i
        if c.candidates[o] > 0 and c.weight[o] > 0.0:
            store(m, c, i, load(m, c, i) + c.push[o])
            c.start[o] = c.start[o] + c.shift[o]

    @wp.func
    def push_corner(
        c: Cloth, k: int, again: bool, change: wp.vec3, share: float, shift: wp.vec3
    ) -> None:
        """Add to what corner k of all is pushed and, so that it gets no speed by that, its start shifted."""
        push = wp.vec4(change[0], change[1], change[2], share)
        shifted = shift
        if again:
            push = push + c.corner_push[k]
            shifted = shift + c.corner_shift[k]
        c.corner_push[k] = push
        c.corner_shift[k] = shifted

    @wp.func
    def touch(c: Cloth, m: wp.uint64, world: int, f: int):
        """Push a triangle out of shapes at the point where it is deepest in each, with friction there."""
        bits = c.face_near[world, f]
        if bits < 0:  # it touched in the last sub-step
            bits = ~bits
        if bits != 0:
            ends = c.face[f]
            o = world * c.vertices
            k = 3 * (world * c.faces + f)
            # few numbers live from one shape to the next: registers are what threads are short of
            touched = bool(False)
            for shape in range(c.tools.shapes):
                if ((bits >> shape) & 1) == 1:
                    x0 = load(m, c, ends[0])
                    x1 = load(m, c, ends[1])
                    x2 = load(m, c, ends[2])
                    if touched:
                        x0 += xyz(c.corner_push[k])
                        x1 += xyz(c.corner_push[k + 1])
                        x2 += xyz(c.corner_push[k + 2])
                    p0 = within_shape(c.tools, world, shape, x0)
                    p1 = within_shape(c.tools, world, shape, x1)
                    p2 = within_shape(c.tools, world, shape, x2)
                    share, found = deepest(c.tools, shape, p0, p1, p2, c.gap)
                    depth = c.gap - found[3]
                    if depth > 0.0:
                        u0 = share[0] * c.weight[o + ends[0]]
                        u1 = share[1] * c.weight[o + ends[1]]
                        u2 = share[2] * c.weight[o + ends[2]]
                        w = share[0] * u0 + share[1] * u1 + share[2] * u2
                        # beside a corner that is held the others cannot do it alone: none goes
                        # farther than twice the depth
                        most = wp.max(u0, wp.max(u1, u2))
                        w = wp.max(w, 0.5 * most)
                        if w > 0.0:
                            # how much farther out corners are than the point that touches
                            n = xyz(found)
                            at = share[0] * p0 + share[1] * p1 + share[2] * p2
                            h0 = wp.dot(p0 - at, n)
                            h1 = wp.dot(p1 - at, n)
                            h2 = wp.dot(p2 - at, n)
                            n = wp.quat_rotate(c.tools.shape_rotation[world, shape], n)
                            was = carried(c.tools, world, shape, at)
                            s0 = c.start[o + ends[0]]
                            s1 = c.start[o + ends[1]]
                            s2 = c.start[o + ends[2]]
                            if touched:
                                s0 += c.corner_shift[k]
                                s1 += c.corner_shift[k + 1]
                                s2 += c.corner_shift[k + 2]
                            s0 = was - s0
                            s1 = was - s1
                            s2 = was - s2
                            slip = share[0] * s0 + share[1] * s1 + share[2] * s2
                            slip = slip - wp.dot(slip, n) * n
                            mu = 0.5 * (c.friction[world] + c.tools.friction[shape])
                            change = (depth * n - friction(slip, depth, mu, mu)) / w
                            along = wp.dot(change, n)
                            t0 = excess(h0 + wp.dot(s0, n), u0 * along)
                            t1 = excess(h1 + wp.dot(s1, n), u1 * along)
                            t2 = excess(h2 + wp.dot(s2, n), u2 * along)
                            push_corner(c, k, touched, u0 * change, share[0], t0 * n)
                            push_corner(c, k + 1, touched, u1 * change, share[1], t1 * n)
                            push_corner(c, k + 2, touched, u2 * change, share[2], t2 * n)
                            touched = True
            c.face_near[world, f] = wp.where(touched, ~bits, bits)

    @wp.func
    def leave_shapes(c: Cloth, m: wp.uint64, world: int, i: int):
        """A vertex where its triangles were pushed to, and then out of shapes whole."""
        o = world * c.vertices + i
        marked = c.near[o]
        if marked != 0:
            bits = ~marked
            x = load(m, c, i)
            start = c.start[o]
            push = wp.vec3(0.0)
            shift = wp.vec3(0.0)
            total = float(0.0)
            for k in range(c.corner_start[i], c.corner_start[i + 1]):
                corner = c.corner[k]
                if c.face_near[world, corner / 3] < 0:
                    q = 3 * world * c.faces + corner
                    theirs = c.corner_push[q]
                    push += theirs[3] * xyz(theirs)
                    shift += theirs[3] * c.corner_shift[q]
                    total += theirs[3]
            moved = bool(total > 0.0)
            if moved:
                x += push / total
                start += shift / total
            rubs = float(1.0)
            for _again in range(_WEDGED):
                pushed = int(0)
                for shape in range(c.tools.shapes):
                    if ((bits >> shape) & 1) == 1:
                        p = within_shape(c.tools, world, shape, x)
                        found = local_distance(c.tools, shape, p)
                        depth = c.gap - found[3]
                        if depth > 0.0:
                            pushed += 1
                            n = wp.quat_rotate(c.tools.shape_rotation[world, shape], xyz(found))
                            was = carried(c.tools, world, shape, p)
                            slip = was - start
                            slip = slip - wp.dot(slip, n) * n
                            both = 0.5 * (c.friction[world] + c.tools.friction[shape])
                            rub = rubs * friction(slip, depth, both, both)
                            start += excess(wp.dot(was - start, n), depth) * n
                            x += depth * n - rub
                if pushed > 0:
                    moved = True
                if pushed < 2:
                    break
                rubs = 0.0
            if moved:
                first = c.start[o]
                impulse = (x - load(m, c, i)) - (start - first)
                store(m, c, i, x)
                c.start[o] = start
                scale = c.density[world] / (c.weight[o] * c.dt * c.dt * float(c.substeps))
                c.force[o] = c.force[o] + scale * impulse

    @wp.func
    def finish(c: Cloth, m: wp.uint64, world: int, i: int):
        """Out of shapes, and the new velocity."""
        o = world * c.vertices + i
        if c.weight[o] > 0.0:
            if wp.static(SHAPES):
                leave_shapes(c, m, world, i)
            c.velocity[o] = (load(m, c, i) - c.start[o]) / c.dt

    @wp.func
    def judge(c: Cloth, m: wp.uint64, world: int, i: int):
        """From which side a vertex is touched."""
        o = world * c.vertices + i
        force = c.force[o]
        side = float(0.0)
        if wp.dot(force, force) > 0.0:
            n = wp.vec3(0.0)
            for k in range(c.corner_start[i], c.corner_start[i + 1]):
                ends = c.face[c.corner[k] / 3]
                a = load(m, c, ends[0])
                n += wp.cross(load(m, c, ends[1]) - a, load(m, c, ends[2]) - a)
            side = wp.where(wp.dot(force, n) < 0.0, -1.0, 1.0)
        c.side[o] = side

    @wp.func
    def move_tools(c: Cloth, world: int, lane: int, lanes: int):
        remaining = float(c.substeps - c.substep[world])
        advance_tools(c.tools, c.control, world, lane, lanes, remaining, c.dt)

    @wp.func
    def count_substep(c: Cloth, world: int):
        for g in range(c.grips):
            c.closed[world, g] = wp.where(c.control[world, 6 * c.tools.tools + g] > 0.5, 1.0, 0.0)
        c.substep[world] = (c.substep[world] + 1) % c.substeps

    # so few registers that a multiprocessor holds as many blocks as make 1024 threads
    bounds = (LANES, max(1, 1024 // LANES))

    @wp.kernel(module="unique", enable_backward=False, launch_bounds=bounds, module_options=_FAST)
    def block_kernel(c: Cloth, count: int):
        world, lane = wp.tid()
        lanes = wp.block_dim()
        n = c.vertices
        m = address(c.position, world * n)
        if wp.static(SHARED):
            for i in range(lane, n, lanes):
                store_all(m, c, i, c.position[world * n + i], c.weight[world * n + i])
            wait_for_block()
        # of what was searched, the layers' candidates are no state: they follow from anchors again
        resumes = bool(False)
        if wp.static(LAYERS):
            resumes = c.substep[world] % c.every != 0
        for _substep in range(count):
            if wp.static(LAYERS or SHAPES):
                if resumes or c.substep[world] % c.every == 0:
                    for k in range(lane, wp.max(wp.max(n, c.buckets), c.tools.shapes), lanes):
                        begin_search(c, m, world, k, resumes)
                    wait_for_block()
                    for k in range(lane, wp.max(n, c.faces), lanes):
                        insert(c, m, world, k, resumes)
                    wait_for_block()
                    for i in range(lane, n, lanes):
                        search(c, m, world, i, resumes)
                    resumes = False
            if wp.static(SHAPES or GRIPS):
                wait_for_block()
                move_tools(c, world, lane, lanes)
                wait_for_block()
                place_shapes(c.tools, world, lane, lanes)
            if wp.static(GRIPS):
                for u in range(lane, c.grip_vertices, lanes):
                    grip(c, m, world, u)
            wait_for_block()
            for i in range(lane, n, lanes):
                predict(c, m, world, i)
            wait_for_block()
            for colour in range(c.colours):
                soft = softness(c, world, c.kind[colour])
                for k in range(c.first[colour] + lane, c.first[colour + 1], lanes):
                    keep_distance(c, m, world, k, soft)
                wait_for_block()
            bends = bending_substeps(c, world)
            if bends > 0:
                soft = softness(c, world, BENDING) / float(bends)
                for colour in range(c.quad_colours):
                    for k in range(c.quad_first[colour] + lane, c.quad_first[colour + 1], lanes):
                        keep_flat(c, m, world, k, soft)
                    wait_for_block()
            if wp.static(LAYERS):
                for i in range(lane, n, lanes):
                    find_layers(c, m, world, i)
                wait_for_block()
                for i in range(lane, n, lanes):
                    part_layers(c, m, world, i)
                wait_for_block()
            if wp.static(SHAPES):
                for f in range(lane, c.faces, lanes):
                    touch(c, m, world, f)
                wait_for_block()
            for i in range(lane, n, lanes):
                finish(c, m, world, i)
            if lane == 0:
                count_substep(c, world)
            wait_for_block()
        for i in range(lane, n, lanes):
            judge(c, m, world, i)
            if wp.static(SHARED):
                c.position[world * n + i] = load(m, c, i)

    @wp.func
    def searches(c: Cloth, world: int, resumes: bool) -> bool:
        due = c.substep[world] % c.every == 0
        return due != resumes

    def each(phase: Any) -> Any:
        """A kernel with a thread for each item of `phase`, which goes through it."""

        @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
        def kernel(c: Cloth):
            world, i = wp.tid()
            phase(c, packed_address(c.position, world * c.vertices), world, i)

        return kernel

    def each_of_search(phase: Any) -> Any:
        """The same of a phase of the search, where one is due or, as state is set, `resumes`."""

        @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
        def kernel(c: Cloth, resumes: bool):
            world, k = wp.tid()
            if searches(c, world, resumes):
                phase(c, packed_address(c.position, world * c.vertices), world, k, resumes)

        return kernel

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def tools_kernel(c: Cloth):
        world = wp.tid()
        move_tools(c, world, 0, 1)
        place_shapes(c.tools, world, 0, 1)

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def edges_kernel(c: Cloth, colour: int, first: int):
        world, k = wp.tid()
        m = packed_address(c.position, world * c.vertices)
        keep_distance(c, m, world, first + k, softness(c, world, c.kind[colour]))

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def hinges_kernel(c: Cloth, colour: int, first: int):
        world, k = wp.tid()
        m = packed_address(c.position, world * c.vertices)
        bends = bending_substeps(c, world)
        if bends > 0:
            keep_flat(c, m, world, first + k, softness(c, world, BENDING) / float(bends))

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def count_kernel(c: Cloth):
        count_substep(c, wp.tid())

    return Kernels(
        block=block_kernel,
        begin=each_of_search(begin_search),
        insert=each_of_search(insert),
        search=each_of_search(search),
        tools=tools_kernel,
        grip=each(grip),
        predict=each(predict),
        edges=edges_kernel,
        hinges=hinges_kernel,
        find_layers=each(find_layers),
        part_layers=each(part_layers),
        touch=each(touch),
        finish=each(finish),
        count=count_kernel,
        judge=each(judge),
    )
