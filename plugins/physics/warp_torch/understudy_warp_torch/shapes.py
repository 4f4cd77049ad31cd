"""Tools on the device: signed distances of boxes, capsules, tapered capsules and grids, where tools go,
and the friction of what touches them."""

# What Warp compiles is not quite Python: variables that loops change are made with float(0.0), and
# conditions known when compiling stand alone.
# ruff: noqa: UP018
# pyright: reportInvalidTypeForm=false

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import warp as wp
from torch import Tensor

from understudy_warp_torch.tools import Box, Capsule, Grid, Shape, TaperedCapsule, Tool

__all__ = [
    "GRID",
    "Tools",
    "advance_tools",
    "build_tools",
    "friction",
    "from_rotation_vector",
    "local_distance",
    "place_shapes",
    "rotation",
    "shape_distance",
    "to_rotation_vector",
    "tool_between",
    "tool_views",
    "xyz",
]

BOX, CAPSULE, GRID, TAPERED = wp.constant(0), wp.constant(1), wp.constant(2), wp.constant(3)
#: Farther than anything touches, m.
FAR = wp.constant(1e6)


@wp.struct
class Tools:
    """T tools that consist of S shapes together, in N worlds. Rotations of shapes are Warp's (xyzw)."""

    tools: int  # T
    shapes: int  # S
    # what does not change, (S,)
    kind: wp.array(dtype=int)
    tool: wp.array(dtype=int)
    size: wp.array(dtype=wp.vec3)
    offset: wp.array(dtype=wp.vec3)
    turn: wp.array(dtype=wp.quat)
    centre: wp.array(dtype=wp.vec3)
    bound: wp.array(dtype=float)
    core: wp.array(dtype=float)  # how deep the shape is, m
    friction: wp.array(dtype=float)
    grid_start: wp.array(dtype=int)
    grid_points: wp.array(dtype=wp.vec3i)
    grid_values: wp.array(dtype=float)
    # the state, (N, T), and where tools were when the sub-step began
    position: wp.array2d(dtype=wp.vec3)
    orientation: wp.array2d(dtype=wp.vec4)
    velocity: wp.array2d(dtype=wp.vec3)
    angular_velocity: wp.array2d(dtype=wp.vec3)
    position_before: wp.array2d(dtype=wp.vec3)
    orientation_before: wp.array2d(dtype=wp.vec4)
    # shapes in the world, (N, S), now and when the sub-step began
    shape_position: wp.array2d(dtype=wp.vec3)
    shape_rotation: wp.array2d(dtype=wp.quat)
    shape_position_before: wp.array2d(dtype=wp.vec3)
    shape_rotation_before: wp.array2d(dtype=wp.quat)


@wp.func
def friction(slip: wp.vec3, depth: float, static: float, dynamic: float) -> wp.vec3:
    """The part of the tangential displacement `slip` that friction takes back, at a contact
    corrected by `depth` (Macklin et al. 2014, equation 24)."""
    length = wp.length(slip)
    share = float(1.0)
    if length >= static * depth:
        share = wp.min(dynamic * depth / length, 1.0)
    if length <= 0.0:
        share = 0.0
    return share * slip


@wp.func
def xyz(v: wp.vec4) -> wp.vec3:
    """The first three."""
    return wp.vec3(v[0], v[1], v[2])


@wp.func
def rotation(wxyz: wp.vec4) -> wp.quat:
    """Warp's quaternion (xyzw)."""
    return wp.quat(wxyz[1], wxyz[2], wxyz[3], wxyz[0])


@wp.func
def from_rotation_vector(vector: wp.vec3) -> wp.quat:
    """The rotation about `vector` by its length, rad."""
    angle = wp.length(vector)
    half = 0.5 * angle
    scale = 0.5 - half * half / 12.0  # sin(angle/2) / angle where it is small
    if angle > 1e-3:
        scale = wp.sin(half) / angle
    return wp.quat(scale * vector[0], scale * vector[1], scale * vector[2], wp.cos(half))


@wp.func
def to_rotation_vector(turn: wp.quat) -> wp.vec3:
    """The shorter way."""
    sign = wp.where(turn[3] < 0.0, -1.0, 1.0)
    axis = sign * wp.vec3(turn[0], turn[1], turn[2])
    sine = wp.length(axis)
    scale = float(2.0)
    if sine > 1e-6:
        scale = 2.0 * wp.atan2(sine, sign * turn[3]) / sine
    return scale * axis


@wp.func
def move_tool(
    tools: Tools,
    control: wp.array2d(dtype=float),
    world: int,
    tool: int,
    remaining: float,
    dt: float,
):
    """Go 1/`remaining` of the way to the target pose, which so is reached after `remaining` equal
    sub-steps."""
    c = 6 * tool
    target = wp.vec3(control[world, c], control[world, c + 1], control[world, c + 2])
    turn = wp.vec3(control[world, c + 3], control[world, c + 4], control[world, c + 5])
    before = tools.position[world, tool]
    oriented = tools.orientation[world, tool]
    q = rotation(oriented)
    way = (target - before) / remaining
    angle = to_rotation_vector(from_rotation_vector(turn) * wp.quat_inverse(q)) / remaining
    after = wp.normalize(from_rotation_vector(angle) * q)
    tools.position_before[world, tool] = before
    tools.orientation_before[world, tool] = oriented
    tools.position[world, tool] = before + way
    tools.orientation[world, tool] = wp.vec4(after[3], after[0], after[1], after[2])
    tools.velocity[world, tool] = way / dt
    tools.angular_velocity[world, tool] = angle / dt


@wp.func
def place_shape(tools: Tools, world: int, shape: int):
    """Where a shape of a tool that has moved is, and was."""
    tool = tools.tool[shape]
    q = rotation(tools.orientation_before[world, tool])
    tools.shape_position_before[world, shape] = tools.position_before[world, tool] + wp.quat_rotate(
        q, tools.offset[shape]
    )
    tools.shape_rotation_before[world, shape] = q * tools.turn[shape]
    q = rotation(tools.orientation[world, tool])
    tools.shape_position[world, shape] = tools.position[world, tool] + wp.quat_rotate(
        q, tools.offset[shape]
    )
    tools.shape_rotation[world, shape] = q * tools.turn[shape]


@wp.func
def advance_tools(
    tools: Tools,
    control: wp.array2d(dtype=float),
    world: int,
    lane: int,
    lanes: int,
    remaining: float,
    dt: float,
):
    """Move the tools by a sub-step towards their targets, each lane its share of them."""
    for tool in range(lane, tools.tools, lanes):
        move_tool(tools, control, world, tool, remaining, dt)


@wp.func
def place_shapes(tools: Tools, world: int, lane: int, lanes: int):
    """Put the shapes where their tools are, each lane its share of them."""
    for shape in range(lane, tools.shapes, lanes):
        place_shape(tools, world, shape)


@wp.func
def box_distance(half: wp.vec3, p: wp.vec3) -> wp.vec4:
    """Outward normal and signed distance."""
    q = wp.vec3(wp.abs(p[0]), wp.abs(p[1]), wp.abs(p[2])) - half
    sign = wp.vec3(
        wp.where(p[0] < 0.0, -1.0, 1.0),
        wp.where(p[1] < 0.0, -1.0, 1.0),
        wp.where(p[2] < 0.0, -1.0, 1.0),
    )
    outside = wp.vec3(wp.max(q[0], 0.0), wp.max(q[1], 0.0), wp.max(q[2], 0.0))
    distance = wp.length(outside)
    n = wp.vec3(0.0, 0.0, sign[2])
    if distance > 0.0:
        n = wp.cw_mul(sign, outside) / distance
    else:
        distance = wp.max(q[0], wp.max(q[1], q[2]))
        if q[0] >= q[1] and q[0] >= q[2]:
            n = wp.vec3(sign[0], 0.0, 0.0)
        elif q[1] >= q[2]:
            n = wp.vec3(0.0, sign[1], 0.0)
    return wp.vec4(n[0], n[1], n[2], distance)


@wp.func
def capsule_distance(radius: float, half_length: float, p: wp.vec3) -> wp.vec4:
    """Outward normal and signed distance; the axis is z."""
    away = p - wp.vec3(0.0, 0.0, wp.clamp(p[2], -half_length, half_length))
    distance = wp.length(away)
    n = wp.vec3(1.0, 0.0, 0.0)
    if distance > 0.0:
        n = away / distance
    return wp.vec4(n[0], n[1], n[2], distance - radius)


@wp.func
def tapered_distance(ra: float, rb: float, half_length: float, p: wp.vec3) -> wp.vec4:
    """Outward normal and signed distance; the axis is z, the sphere of radius `ra` at its lower end."""
    length = 2.0 * half_length
    along = p[2] + half_length
    across = wp.sqrt(p[0] * p[0] + p[1] * p[1])
    sine = (ra - rb) / length  # of the flank's angle with the axis
    cosine = wp.sqrt(1.0 - sine * sine)
    side = along * cosine - across * sine
    u = cosine  # the normal's parts across and along the axis
    w = sine
    distance = across * cosine + along * sine - ra
    if side < 0.0 or side > cosine * length:
        radius = ra
        centre = float(0.0)
        if side >= 0.0:
            radius = rb
            centre = length
        away = wp.sqrt(across * across + (along - centre) * (along - centre))
        u = float(1.0)
        w = float(0.0)
        if away > 0.0:
            u = across / away
            w = (along - centre) / away
        distance = away - radius
    n = wp.vec3(u, 0.0, w)
    if across > 0.0:
        n = wp.vec3(u * p[0] / across, u * p[1] / across, w)
    return wp.vec4(n[0], n[1], n[2], distance)


@wp.func
def grid_distance(
    values: wp.array(dtype=float),
    start: int,
    points: wp.vec3i,
    spacing: float,
    p: wp.vec3,
) -> wp.vec4:
    """Outward normal and signed distance, linear between the grid's points; beyond them, where nothing
    is touched, no more than the distance."""
    x = wp.clamp(p[0] / spacing, 0.0, float(points[0]) - 1.001)
    y = wp.clamp(p[1] / spacing, 0.0, float(points[1]) - 1.001)
    z = wp.clamp(p[2] / spacing, 0.0, float(points[2]) - 1.001)
    beyond = wp.length(p - spacing * wp.vec3(x, y, z))
    i = int(wp.floor(x))
    j = int(wp.floor(y))
    k = int(wp.floor(z))
    fx = x - float(i)
    fy = y - float(j)
    fz = z - float(k)
    row = points[2]
    plane = points[1] * points[2]
    a = start + i * plane + j * row + k
    v000 = values[a]
    v001 = values[a + 1]
    v010 = values[a + row]
    v011 = values[a + row + 1]
    v100 = values[a + plane]
    v101 = values[a + plane + 1]
    v110 = values[a + plane + row]
    v111 = values[a + plane + row + 1]
    v00 = wp.lerp(v000, v001, fz)
    v01 = wp.lerp(v010, v011, fz)
    v10 = wp.lerp(v100, v101, fz)
    v11 = wp.lerp(v110, v111, fz)
    v0 = wp.lerp(v00, v01, fy)
    v1 = wp.lerp(v10, v11, fy)
    gy = wp.lerp(v01 - v00, v11 - v10, fx)
    gz = wp.lerp(wp.lerp(v001 - v000, v011 - v010, fy), wp.lerp(v101 - v100, v111 - v110, fy), fx)
    n = wp.normalize(wp.vec3(v1 - v0, gy, gz))
    distance = wp.lerp(v0, v1, fx)
    if beyond > 0.01 * spacing:
        distance = wp.max(beyond, distance - beyond)
    return wp.vec4(n[0], n[1], n[2], distance)


@wp.func
def local_distance(tools: Tools, shape: int, p: wp.vec3) -> wp.vec4:
    """Outward normal and signed distance of a point in the frame of a shape."""
    kind = tools.kind[shape]
    size = tools.size[shape]
    if kind == BOX:
        return box_distance(size, p)
    if kind == CAPSULE:
        return capsule_distance(size[0], size[1], p)
    if kind == TAPERED:
        return tapered_distance(size[0], size[1], size[2], p)
    return grid_distance(
        tools.grid_values, tools.grid_start[shape], tools.grid_points[shape], size[0], p
    )


@wp.func
def shape_distance(tools: Tools, world: int, shape: int, x: wp.vec3) -> wp.vec4:
    """Outward normal and signed distance of a point of a world, where the shape is now."""
    q = tools.shape_rotation[world, shape]
    p = wp.quat_rotate_inv(q, x - tools.shape_position[world, shape])
    found = local_distance(tools, shape, p)
    n = wp.quat_rotate(q, wp.vec3(found[0], found[1], found[2]))
    return wp.vec4(n[0], n[1], n[2], found[3])


@wp.func
def tool_distance(tools: Tools, world: int, x: wp.vec3) -> float:
    """Signed distance from x to the nearest tool, m."""
    nearest = FAR
    for shape in range(tools.shapes):
        found = shape_distance(tools, world, shape, x)
        nearest = wp.min(nearest, found[3])
    return nearest


@wp.func
def tool_between(tools: Tools, world: int, a: wp.vec3, b: wp.vec3) -> bool:
    """Whether a tool cuts the segment from a to b, which is the same seen from either end."""
    middle = 0.5 * (a + b)
    half = 0.5 * wp.length(b - a)
    for shape in range(tools.shapes):
        found = shape_distance(tools, world, shape, middle)
        if found[3] <= 0.0:
            return True
        if found[3] < half:  # not farther than the ends: look along both halves
            for k in range(1, 5):
                t = 0.25 * float(k)
                ahead = shape_distance(tools, world, shape, middle + t * (b - middle))
                behind = shape_distance(tools, world, shape, middle + t * (a - middle))
                if wp.min(ahead[3], behind[3]) <= 0.0:
                    return True
    return False


def _quaternion(wxyz: Sequence[float]) -> np.ndarray:
    q = np.asarray(wxyz, float)
    return q / np.linalg.norm(q)


def _extent(shape: Shape) -> tuple[np.ndarray, float]:
    """Centre, in the shape's frame, and radius of a sphere around it, m."""
    if isinstance(shape, Box):
        return np.zeros(3), float(np.linalg.norm(shape.half_extents))
    if isinstance(shape, Capsule):
        return np.zeros(3), shape.radius + shape.half_length
    if isinstance(shape, TaperedCapsule):
        return np.zeros(3), max(shape.radii) + shape.half_length
    sides = (np.array(shape.distances.shape) - 1) * shape.spacing
    return 0.5 * sides, 0.5 * float(np.linalg.norm(sides))


def _depth(shape: Shape) -> float:
    """How far the point that is deepest within the shape is from its surface, m."""
    if isinstance(shape, Box):
        return min(shape.half_extents)
    if isinstance(shape, Capsule):
        return shape.radius
    if isinstance(shape, TaperedCapsule):
        return 0.5 * sum(shape.radii)
    return max(-float(np.min(shape.distances)), 0.0)


def build_tools(tools: Sequence[Tool], worlds: int) -> Any:
    """The struct on Warp's present device, with all tools where they are at first."""
    shapes = [(number, shape) for number, tool in enumerate(tools) for shape in tool.shapes]
    kinds, owners, sizes, offsets, turns, centres, bounds, frictions = ([] for _ in range(8))
    starts, points, values = [], [], [np.zeros(1)]
    cores = [_depth(shape) for _, shape in shapes]
    for number, shape in shapes:
        owners.append(number)
        frictions.append(tools[number].friction)
        centre, bound = _extent(shape)
        centres.append(centre)
        bounds.append(bound)
        starts.append(sum(len(v) for v in values))
        points.append((0, 0, 0))
        if isinstance(shape, Grid):
            kinds.append(int(GRID))
            sizes.append((shape.spacing, 0.0, 0.0))
            offsets.append(shape.origin)
            turns.append((0.0, 0.0, 0.0, 1.0))
            points[-1] = shape.distances.shape
            values.append(np.asarray(shape.distances, float).reshape(-1))
            continue
        offsets.append(shape.position)
        w, x, y, z = _quaternion(shape.orientation)
        turns.append((x, y, z, w))
        if isinstance(shape, Box):
            kinds.append(int(BOX))
            sizes.append(shape.half_extents)
        elif isinstance(shape, TaperedCapsule):
            kinds.append(int(TAPERED))
            sizes.append((*shape.radii, shape.half_length))
        else:
            kinds.append(int(CAPSULE))
            sizes.append((shape.radius, shape.half_length, 0.0))
    s, t = len(shapes), len(tools)

    def constant(data: Any, dtype: Any, width: int = 0) -> Any:
        shaped = np.asarray(data, float).reshape((s, width) if width else -1)
        if dtype in (int, wp.vec3i):
            shaped = shaped.astype(np.int32)
        return wp.array(shaped, dtype=dtype)

    result = Tools()
    result.tools, result.shapes = t, s
    result.kind, result.tool = constant(kinds, int), constant(owners, int)
    result.size, result.offset = constant(sizes, wp.vec3, 3), constant(offsets, wp.vec3, 3)
    result.turn, result.centre = constant(turns, wp.quat, 4), constant(centres, wp.vec3, 3)
    result.bound, result.friction = constant(bounds, float), constant(frictions, float)
    result.core = constant(cores, float)
    result.grid_start, result.grid_points = constant(starts, int), constant(points, wp.vec3i, 3)
    result.grid_values = wp.array(np.concatenate(values), dtype=float)
    places = np.tile(np.array([tool.position for tool in tools]).reshape(t, 3), (worlds, 1, 1))
    turned = np.array([_quaternion(tool.orientation) for tool in tools]).reshape(t, 4)
    turned = np.tile(turned, (worlds, 1, 1))
    result.position = wp.array(places, dtype=wp.vec3, shape=(worlds, t))
    result.orientation = wp.array(turned, dtype=wp.vec4, shape=(worlds, t))
    result.velocity = wp.zeros((worlds, t), dtype=wp.vec3)
    result.angular_velocity = wp.zeros((worlds, t), dtype=wp.vec3)
    result.position_before = wp.clone(result.position)
    result.orientation_before = wp.clone(result.orientation)
    result.shape_position = wp.zeros((worlds, s), dtype=wp.vec3)
    result.shape_rotation = wp.zeros((worlds, s), dtype=wp.quat)
    result.shape_position_before = wp.zeros((worlds, s), dtype=wp.vec3)
    result.shape_rotation_before = wp.zeros((worlds, s), dtype=wp.quat)
    return result


def tool_views(tools: Any) -> dict[str, tuple[Tensor, tuple[int, ...]]]:
    """By the field's name: where tools are and how they move, as torch views, and each world's shape.

    The number of tools leads it if there are several; without any there is no field.
    """
    count = int(tools.tools)
    lead = (count,) if count > 1 else ()
    fields = {
        "tool_position": (tools.position, 3),
        "tool_orientation": (tools.orientation, 4),
        "tool_velocity": (tools.velocity, 3),
        "tool_angular_velocity": (tools.angular_velocity, 3),
    }
    return {
        name: (wp.to_torch(view), (*lead, size)) for name, (view, size) in fields.items() if count
    }
