"""Cloth that touches shapes: triangles where they are deepest, and vertices."""

# What Warp compiles is not quite Python: see solver.py.
# ruff: noqa: UP018, RUF046

from typing import Any, NamedTuple

import warp as wp

from understudy_cloth.memory import Memory
from understudy_cloth.world import Cloth
from understudy_warp_torch.shapes import GRID, Tools, friction, local_distance, xyz

#: How often the point of a triangle that is deepest in a shape is improved.
_SEARCHES = wp.constant(3)
#: m: that point is found when no other of the triangle can be deeper by more than this.
_DECIDED = wp.constant(2e-5)
#: How often a vertex is pushed out of bodies that push it into each other.
_WEDGED = wp.constant(4)


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


class Contact(NamedTuple):
    """The two phases of a sub-step, in this order."""

    touch: Any  #: (cloth, m, world, triangle)
    leave_shapes: Any  #: (cloth, m, world, vertex)


def contact_of(memory: Memory) -> Contact:
    """Of cloth whose positions are in this `memory`."""
    load, store = memory.load, memory.store

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

    return Contact(touch, leave_shapes)
