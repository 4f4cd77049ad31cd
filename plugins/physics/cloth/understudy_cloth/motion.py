"""How a sub-step begins and ends: tools and grips move, vertices fall, and get the velocity of their way."""

# What Warp compiles is not quite Python: see solver.py.
# ruff: noqa: UP018, RUF046, SIM102

from typing import Any, NamedTuple

import warp as wp

from understudy_cloth.contact import Contact
from understudy_cloth.memory import Memory
from understudy_cloth.world import Cloth, Features
from understudy_warp_torch.shapes import advance_tools, rotation


@wp.func
def move_tools(c: Cloth, world: int, lane: int, lanes: int):
    """Tools, a share of what remains of their way in the control period."""
    remaining = float(c.substeps - c.substep[world])
    advance_tools(c.tools, c.control, world, lane, lanes, remaining, c.dt)


@wp.func
def count_substep(c: Cloth, world: int):
    """The sub-step is over; grips are as closed as they were asked to be."""
    for g in range(c.grips):
        c.closed[world, g] = wp.where(c.control[world, 6 * c.tools.tools + g] > 0.5, 1.0, 0.0)
    c.substep[world] = (c.substep[world] + 1) % c.substeps


class Motion(NamedTuple):
    """Each a phase of one vertex: (cloth, m, world, vertex); of `grip`, of one that grips may hold."""

    grip: Any
    predict: Any
    finish: Any
    judge: Any


def motion_of(features: Features, memory: Memory, contact: Contact) -> Motion:
    """Of scenes with these `features`, whose positions are in this `memory`."""
    SHAPES = wp.constant(features.shapes)
    load, store, weigh = memory.load, memory.store, memory.weigh
    leave_shapes = contact.leave_shapes

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
        weigh(m, i, weight)

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

    return Motion(grip, predict, finish, judge)
