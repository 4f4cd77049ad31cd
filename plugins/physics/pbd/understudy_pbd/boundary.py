"""What particles cannot pass: tools, the table and its walls."""

# variables that loops change are made with float(0.0), or Warp takes them for constants
# ruff: noqa: UP018, RUF046

import warp as wp

from understudy_pbd.constraints import missing_slope
from understudy_pbd.world import System
from understudy_warp_torch.shapes import friction, local_distance, shape_distance, xyz

#: How often a particle is pushed out of tools and table that push it into each other.
_WEDGED = wp.constant(4)


@wp.func
def swept(s: System, world: int, start: wp.vec3, x: wp.vec3, radius: float) -> wp.vec3:
    """`x`, or where a particle on its way there from `start` first met a tool that both move fast
    enough to miss each other in a sub-step (sphere tracing in the frame of the shape)."""
    result = x
    for shape in range(s.tools.shapes):
        at_before = s.tools.shape_position_before[world, shape]
        at = s.tools.shape_position[world, shape]
        before = wp.quat_rotate_inv(s.tools.shape_rotation_before[world, shape], start - at_before)
        turn = s.tools.shape_rotation[world, shape]
        after = wp.quat_rotate_inv(turn, result - at)
        way = after - before
        length = wp.length(way)
        if length > radius:
            meets = float(-1.0)
            done = float(0.0)
            for _step in range(16):
                found = local_distance(s.tools, shape, before + (done / length) * way)
                gap = found[3] - 0.5 * radius
                if gap < 0.0:
                    if wp.dot(xyz(found), way) < 0.0:
                        meets = done
                    break
                done = done + wp.max(gap, 0.1 * radius)
                if done >= length:
                    break
            if meets >= 0.0:
                result = at + wp.quat_rotate(turn, before + (meets / length) * way)
    return result


@wp.func
def wall(s: System, side: int, x: wp.vec3) -> wp.vec4:
    """Normal of the table (0) or of one of four walls, and the distance of x from it."""
    result = wp.vec4(0.0, 0.0, 1.0, x[2])
    if side == 1:
        result = wp.vec4(1.0, 0.0, 0.0, x[0] - s.lower[0])
    elif side == 2:
        result = wp.vec4(-1.0, 0.0, 0.0, s.upper[0] - x[0])
    elif side == 3:
        result = wp.vec4(0.0, 1.0, 0.0, x[1] - s.lower[1])
    elif side == 4:
        result = wp.vec4(0.0, -1.0, 0.0, s.upper[1] - x[1])
    return result


@wp.func
def wall_gradient(s: System, x: wp.vec3, h: float) -> wp.vec3:
    """Of the share of the rest density that table and walls leave out around x, 1/m."""
    result = wp.vec3(0.0)
    for side in range(s.sides):
        plane = wall(s, side, x)
        if plane[3] < h:
            result += missing_slope(plane[3], h) * xyz(plane)
    return result


@wp.func
def count_contact(s: System, world: int, i: int, push: wp.vec3):
    """Add what tools moved a particle by in a sub-step to its mean force: push · m / Δt of momentum, in as many
    sub-steps of Δt as a control period has."""
    if wp.dot(push, push) > 0.0:
        scale = 1.0 / (s.inverse_mass[i] * s.dt * s.dt * float(s.substeps))
        s.contact_force[world, i] = s.contact_force[world, i] + scale * push


@wp.func
def outside(s: System, world: int, i: int, start: wp.vec3, moved: wp.vec3) -> wp.vec3:
    """`moved` out of tools, walls and table, whole and not averaged: nobody pushes these back.

    What is pushed from one into the other, as in the wedge between a tool and the table, is pushed
    some times more, then without friction, or it would jam where nothing can give way.
    """
    x = moved
    radius = s.radius[i]
    material = s.material[i]
    mu = s.friction[world, material]
    ratio = s.static_ratio[material]
    rubs = float(1.0)
    push = wp.vec3(0.0)  # by tools
    for _again in range(_WEDGED):
        pushed = int(0)
        for shape in range(s.tools.shapes):
            at = s.tools.shape_position[world, shape]
            turn = s.tools.shape_rotation[world, shape]
            away = x - (at + wp.quat_rotate(turn, s.tools.centre[shape]))
            near = s.tools.bound[shape] + radius
            if wp.dot(away, away) < near * near:
                found = shape_distance(s.tools, world, shape, x)
                depth = radius - found[3]
                if depth > 0.0:
                    pushed += 1
                    n = xyz(found)
                    # where that point of the tool was when the sub-step began
                    local = wp.quat_rotate_inv(turn, x - at)
                    carried = s.tools.shape_position_before[world, shape] + wp.quat_rotate(
                        s.tools.shape_rotation_before[world, shape], local
                    )
                    slip = carried - start
                    slip = slip - wp.dot(slip, n) * n
                    dynamic = 0.5 * (mu + s.tools.friction[shape])
                    rub = friction(slip, depth, ratio * dynamic, dynamic)
                    x = x + depth * n - rubs * rub
                    push = push + (depth * n - rubs * rub)
        for k in range(s.sides):  # the table last
            plane = wall(s, s.sides - 1 - k, x)
            depth = radius - plane[3]
            if depth > 0.0:
                pushed += 1
                n = xyz(plane)
                slip = x - start
                slip = slip - wp.dot(slip, n) * n
                dynamic = 0.5 * (mu + s.table_friction)
                x = x + depth * n - rubs * friction(slip, depth, ratio * dynamic, dynamic)
        if pushed < 2:
            break
        rubs = 0.0
    count_contact(s, world, i, push)
    return x
