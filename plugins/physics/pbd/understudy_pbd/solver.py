"""Position-based dynamics of N worlds: the phases of a sub-step, and two ways to go through them.

Each phase is a function of one particle of one world, which reads others and writes only its own.
:func:`build_kernels` makes of them

- ``block``: one kernel for any number of sub-steps, a thread block for each world. Positions stay in
  shared memory if they fit. On the CPU a block has one thread.
- one kernel for each phase with a thread for each particle, the same numbers by launches.

The kernels are specialised: what a scene does not have costs nothing.
"""

# What Warp compiles is not quite Python: variables that loops change are made with float(0.0), and
# conditions known when compiling stand alone.
# ruff: noqa: UP018, RUF046, SIM102
# pyright: reportInvalidTypeForm=false

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from understudy_pbd.constraints import (
    contact,
    density_kernel,
    density_slope,
    missing_density,
    missing_slope,
    spring,
)
from understudy_warp_torch.blocks import global_memory as global_address
from understudy_warp_torch.blocks import load_row, shared_memory, store_row, wait_for_block
from understudy_warp_torch.shapes import (
    Tools,
    advance_tools,
    friction,
    local_distance,
    place_shapes,
    shape_distance,
    xyz,
)

#: Rows of working memory for each particle: two of positions and the weight of its constraints, 1 over
#: their number (−1: it is not there), which iterations read and write in turn, and one of where the
#: sub-step began, with λ of the fluid.
ROWS = 3
#: Particles whose working memory fits into the shared memory of a block: 45 of 48 KiB, of which Warp
#: takes one.
SHARED_PARTICLES = 960
#: Nearer than this particles have no direction from each other, m.
_NEAR = wp.constant(1e-9)
#: How often a particle is pushed out of tools and table that push it into each other.
_WEDGED = wp.constant(4)
#: Particles of fluids touch at this share of the sum of their radii: nearer than the density
#: constraint ever has them in a body of fluid, but where a sheet is thin it does not hold.
_FLUID_CONTACT = wp.constant(0.7)


#: Division and roots to 2 bits less, on CUDA.
_FAST = {"fast_math": True}


@wp.struct
class System:
    """What kernels are handed. N worlds, P particles, K slots for springs, M neighbours, Q materials."""

    # the state
    position: wp.array2d(dtype=wp.vec3)
    velocity: wp.array2d(dtype=wp.vec3)
    active: wp.array2d(dtype=float)
    contact_force: wp.array2d(dtype=wp.vec3)  # of tools, mean over the present control period, N
    spring_partner: wp.array3d(dtype=int)
    spring_length: wp.array3d(dtype=float)
    substep: wp.array(dtype=int)  # done in the present control period, (N,)
    tools: Tools
    control: wp.array2d(dtype=float)
    particles: int
    # particles and materials; what worlds may differ in is (N, …)
    radius: wp.array(dtype=float)
    inverse_mass: wp.array(dtype=float)
    material: wp.array(dtype=int)
    gravity: wp.array(dtype=wp.vec3)
    friction: wp.array2d(dtype=float)
    static_ratio: wp.array(dtype=float)  # of static to dynamic friction, (Q,)
    cohesion: wp.array2d(dtype=float)
    cohesion_range: wp.array(dtype=float)
    damping: wp.array(dtype=float)
    rest_density: wp.array(dtype=float)  # 0: no fluid
    viscosity: wp.array2d(dtype=float)
    tension: wp.array(dtype=float)
    softening: wp.array(dtype=float)  # of the density constraint, (Q,)
    # table
    sides: int  # 0: no table, 1: the table, 5: and walls
    table_friction: float
    lower: wp.vec2
    upper: wp.vec2
    # solver
    dt: float
    substeps: int
    iterations: int
    relaxation: float
    sleep: float
    reach: float
    room: int  # M
    slots: int  # K
    smoothing: float
    stiffness: float  # of springs, in an iteration
    per_iteration: float  # 1 / iterations
    # working memory
    memory: wp.array(dtype=wp.vec4)  # (N · ROWS · P,)
    neighbour: wp.array3d(dtype=int)
    neighbour_count: wp.array2d(dtype=int)
    overflow: wp.array2d(dtype=int)


@dataclass(frozen=True)
class Features:
    """What the kernels of a scene can do, known when they are compiled."""

    fluids: bool
    springs: bool
    alike: bool  #: all particles have one radius, mass and material, which is no fluid
    shared: int  #: particles that shared memory has room for; 0: working memory is not there
    threads: int  #: of a block


@dataclass(frozen=True)
class Kernels:
    """What is launched, each with its arguments and its number of threads."""

    block: Any  #: (system, sub-steps), tiled by worlds
    tools: Any  #: (system,), N
    predict: Any  #: (system,), (N, P), as all below
    find: Any
    density: Any  #: (system, first row to read), as all below
    solve: Any
    finish: Any
    viscosity: Any


global_memory = global_address(wp.vec4)


@wp.func
def share_of(share: float, power: float) -> float:
    """What an iteration corrects, so that all together correct `share` (Müller et al. 2007, 3.3)."""
    result = float(0.0)
    if share > 0.0:
        result = 1.0 - wp.pow(1.0 - share, power)
    return result


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
def move_tools(s: System, world: int, lane: int, lanes: int):
    """By a sub-step towards their targets, each lane its share of them."""
    remaining = float(s.substeps - s.substep[world])
    advance_tools(s.tools, s.control, world, lane, lanes, remaining, s.dt)


@wp.func
def count_substep(s: System, world: int):
    """Note that a sub-step is done, and begin anew after the last of a period."""
    s.substep[world] = (s.substep[world] + 1) % s.substeps


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


@functools.cache
def build_kernels(features: Features) -> Kernels:
    """The kernels of all scenes with these `features`."""
    FLUIDS = wp.constant(features.fluids)
    SPRINGS = wp.constant(features.springs)
    ALIKE = wp.constant(features.alike)
    LANES = features.threads
    block_memory = (
        shared_memory(wp.vec4, "float4", ROWS * features.shared)
        if features.shared
        else global_memory
    )

    @wp.func
    def predict(s: System, memory: wp.uint64, world: int, i: int):
        """Macklin et al. 2014, algorithm 1, lines 1 to 4."""
        start = s.position[world, i]
        x = start
        weight = float(1.0)
        # the sub-step is counted already: the period's first is 1, or 0 where it is the only one
        if s.substep[world] == 1 % s.substeps:
            s.contact_force[world, i] = wp.vec3(0.0)
        if s.active[world, i] == 0.0:
            weight = -1.0
        elif s.inverse_mass[i] > 0.0:
            v = s.velocity[world, i] + s.dt * s.gravity[world]
            v = v / (1.0 + s.dt * s.damping[s.material[i]])
            free = start + s.dt * v
            x = swept(s, world, start, free, s.radius[i])
            count_contact(s, world, i, x - free)
        store_row(memory, i, wp.vec4(x[0], x[1], x[2], weight))
        store_row(memory, 2 * s.particles + i, wp.vec4(start[0], start[1], start[2], 0.0))

    @wp.func
    def find(s: System, memory: wp.uint64, world: int, i: int):
        """Particles within reach, and how many of them touch or are tied by springs."""
        own = load_row(memory, i)
        x = xyz(own)
        found = int(0)
        touching = int(0)
        reach = s.reach * s.reach
        room = s.room
        radius = s.radius[i]
        if own[3] > 0.0:
            for j in range(s.particles):
                other = load_row(memory, j)
                apart = x - xyz(other)
                r2 = wp.dot(apart, apart)
                if r2 < reach and other[3] > 0.0 and i != j:
                    if found < room:
                        s.neighbour[world, i, found] = j
                    found += 1
                    both = radius
                    if wp.static(ALIKE):
                        both += radius
                    else:
                        both += s.radius[j]
                    if wp.static(FLUIDS):
                        if (
                            s.rest_density[s.material[i]] > 0.0
                            and s.rest_density[s.material[j]] > 0.0
                        ):
                            both = _FLUID_CONTACT * both
                    if r2 < both * both:
                        touching += 1
            if wp.static(SPRINGS):
                for k in range(s.slots):
                    if s.spring_partner[world, i, k] >= 0:
                        touching += 1
        s.neighbour_count[world, i] = wp.min(found, room)
        if found > room:
            s.overflow[world, i] += 1
        # of the second row, so that who still looks for neighbours reads nothing half-written
        weight = wp.where(own[3] > 0.0, 1.0 / wp.max(float(touching), 1.0), -1.0)
        store_row(memory, s.particles + i, wp.vec4(x[0], x[1], x[2], weight))

    @wp.func
    def density(s: System, memory: wp.uint64, world: int, i: int, source: int):
        """λ of the density constraint (Macklin and Müller 2013, equations 1, 2, 8, 9 and 11), into the row of starts."""
        rest = s.rest_density[s.material[i]]
        if rest > 0.0:
            h = s.smoothing
            x = xyz(load_row(memory, source + i))
            mass = 1.0 / s.inverse_mass[i]
            rho = mass * density_kernel(0.0, h)
            gradient = wp.vec3(0.0)
            squares = float(0.0)
            for k in range(s.neighbour_count[world, i]):
                j = s.neighbour[world, i, k]
                if s.rest_density[s.material[j]] > 0.0:
                    apart = x - xyz(load_row(memory, source + j))
                    r2 = wp.dot(apart, apart)
                    if r2 < h * h:
                        other = 1.0 / s.inverse_mass[j]
                        rho += other * density_kernel(r2, h)
                        r = wp.max(wp.sqrt(r2), _NEAR)
                        g = (other / rest * density_slope(r, h) / r) * apart
                        gradient += g
                        squares += s.inverse_mass[j] * wp.dot(g, g)
            for side in range(s.sides):  # the fluid goes on behind a wall
                plane = wall(s, side, x)
                rho += rest * missing_density(plane[3], h)
            gradient += wall_gradient(s, x, h)
            c = rho / rest - 1.0
            if c < 0.0:
                c = c * s.tension[s.material[i]]
            squares += s.inverse_mass[i] * (wp.dot(gradient, gradient) + s.softening[s.material[i]])
            begin = load_row(memory, 2 * s.particles + i)
            store_row(
                memory, 2 * s.particles + i, wp.vec4(begin[0], begin[1], begin[2], -c / squares)
            )

    @wp.func
    def solve(s: System, memory: wp.uint64, world: int, i: int, source: int, target: int):
        """One Jacobi iteration: where all constraints on a particle, averaged, would have it, and
        then out of what is kinematic."""
        own = load_row(memory, source + i)
        begin = load_row(memory, 2 * s.particles + i)
        x = xyz(own)
        start = xyz(begin)
        w = s.inverse_mass[i]
        if own[3] > 0.0 and w > 0.0:
            material = s.material[i]
            radius = s.radius[i]
            mu = s.friction[world, material]
            ratio = s.static_ratio[material]
            cohesion = share_of(s.cohesion[world, material], s.per_iteration)
            cohering = s.cohesion_range[material]
            rest = float(0.0)
            if wp.static(FLUIDS):
                rest = s.rest_density[material]
            moved = x - start
            delta = wp.vec3(0.0)
            flow = wp.vec3(0.0)
            active = float(0.0)
            for k in range(s.neighbour_count[world, i]):
                j = s.neighbour[world, i, k]
                other = load_row(memory, source + j)
                apart = x - xyz(other)
                r2 = wp.dot(apart, apart)
                both = radius
                share = float(0.5)
                static = ratio * mu
                dynamic = mu
                holds = cohesion
                far = cohering
                flowing = bool(False)
                if wp.static(ALIKE):
                    both += radius
                else:
                    both += s.radius[j]
                    share = w / (w + s.inverse_mass[j])
                    theirs = s.material[j]
                    if theirs != material:
                        dynamic = 0.5 * (mu + s.friction[world, theirs])
                        static = 0.5 * (static + s.static_ratio[theirs] * s.friction[world, theirs])
                        holds = share_of(s.cohesion[world, theirs], s.per_iteration)
                        holds = 0.5 * (cohesion + holds)
                        far = 0.5 * (cohering + s.cohesion_range[theirs])
                    if wp.static(FLUIDS):
                        density_j = s.rest_density[theirs]
                        flowing = rest > 0.0 and density_j > 0.0
                        if flowing and r2 < s.smoothing * s.smoothing:
                            r = wp.max(wp.sqrt(r2), _NEAR)
                            lambdas = begin[3] / (s.inverse_mass[j] * rest)
                            lambdas += load_row(memory, 2 * s.particles + j)[3] / (w * density_j)
                            flow += (lambdas * w * density_slope(r, s.smoothing) / r) * apart
                        if flowing:
                            both = _FLUID_CONTACT * both
                            static = 0.0
                            dynamic = 0.0
                            holds = 0.0
                limit = both
                if holds > 0.0:
                    limit = both * (1.0 + far)
                if r2 < limit * limit:
                    r = wp.sqrt(r2)
                    if r < _NEAR:  # on each other: apart along z, each its own way
                        r = _NEAR
                        apart = wp.vec3(0.0, 0.0, wp.where(i < j, -_NEAR, _NEAR))
                    slip = moved - (xyz(other) - xyz(load_row(memory, 2 * s.particles + j)))
                    change = contact(apart, r, both, slip, static, dynamic, holds)
                    delta += (share * wp.min(own[3], other[3])) * change
                    active += 1.0
            if wp.static(FLUIDS):
                if rest > 0.0:
                    flow += begin[3] * w * wall_gradient(s, x, s.smoothing)
            if wp.static(SPRINGS):
                for k in range(s.slots):
                    j = s.spring_partner[world, i, k]
                    if j >= 0:
                        other = load_row(memory, source + j)
                        if other[3] > 0.0:
                            apart = x - xyz(other)
                            r = wp.max(wp.length(apart), _NEAR)
                            change = spring(apart, r, s.spring_length[world, i, k], s.stiffness)
                            share = w / (w + s.inverse_mass[j])
                            delta += (share * wp.min(own[3], other[3])) * change
                            active += 1.0
            x = outside(s, world, i, start, x + s.relaxation * delta + flow)
            own = wp.vec4(x[0], x[1], x[2], wp.min(own[3], 1.0 / wp.max(active, 1.0)))
        store_row(memory, target + i, own)

    @wp.func
    def finish(s: System, memory: wp.uint64, world: int, i: int, source: int, target: int):
        """New velocities, and positions of what does not sleep (Macklin et al. 2014, algorithm 1,
        lines 27 to 30)."""
        own = load_row(memory, source + i)
        start = xyz(load_row(memory, 2 * s.particles + i))
        x = xyz(own)
        v = wp.vec3(0.0)
        if own[3] > 0.0 and s.inverse_mass[i] > 0.0:
            v = (x - start) / s.dt
            still = wp.length(v) < s.sleep * s.dt * wp.length(s.gravity[world])
            if wp.static(FLUIDS):
                still = still and s.rest_density[s.material[i]] == 0.0
            if still:
                x = start
                v = wp.vec3(0.0)
            s.position[world, i] = x
        s.velocity[world, i] = v
        if wp.static(FLUIDS):
            store_row(memory, target + i, wp.vec4(v[0], v[1], v[2], own[3]))

    @wp.func
    def viscosity(s: System, memory: wp.uint64, world: int, i: int, source: int, target: int):
        """XSPH (Macklin and Müller 2013, equation 17), with the rest density for the density, so that
        a pair gives and takes the same."""
        material = s.material[i]
        rest = s.rest_density[material]
        if rest > 0.0 and s.active[world, i] != 0.0:
            h = s.smoothing
            x = xyz(load_row(memory, source + i))
            v = xyz(load_row(memory, target + i))
            change = wp.vec3(0.0)
            for k in range(s.neighbour_count[world, i]):
                j = s.neighbour[world, i, k]
                if s.material[j] == material:
                    apart = x - xyz(load_row(memory, source + j))
                    r2 = wp.dot(apart, apart)
                    if r2 < h * h:
                        change += density_kernel(r2, h) * (xyz(load_row(memory, target + j)) - v)
            s.velocity[world, i] = (
                v + s.viscosity[world, material] / (s.inverse_mass[i] * rest) * change
            )

    # so few registers that a multiprocessor holds as many blocks as make 1024 threads
    bounds = (LANES, max(1, 1024 // LANES))

    @wp.kernel(module="unique", enable_backward=False, launch_bounds=bounds, module_options=_FAST)
    def block_kernel(s: System, count: int):
        world, lane = wp.tid()
        lanes = wp.block_dim()
        memory = block_memory(s.memory, world * ROWS * s.particles)
        for _substep in range(count):
            move_tools(s, world, lane, lanes)
            wait_for_block()
            place_shapes(s.tools, world, lane, lanes)
            if lane == 0:
                count_substep(s, world)
            wait_for_block()
            for i in range(lane, s.particles, lanes):
                predict(s, memory, world, i)
            wait_for_block()
            for i in range(lane, s.particles, lanes):
                find(s, memory, world, i)
            wait_for_block()
            source = s.particles
            for _iteration in range(s.iterations):
                if wp.static(FLUIDS):
                    for i in range(lane, s.particles, lanes):
                        density(s, memory, world, i, source)
                    wait_for_block()
                for i in range(lane, s.particles, lanes):
                    solve(s, memory, world, i, source, s.particles - source)
                wait_for_block()
                source = s.particles - source
            for i in range(lane, s.particles, lanes):
                finish(s, memory, world, i, source, s.particles - source)
            wait_for_block()
            if wp.static(FLUIDS):
                for i in range(lane, s.particles, lanes):
                    viscosity(s, memory, world, i, source, s.particles - source)
                wait_for_block()

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def tools_kernel(s: System):
        world = wp.tid()
        move_tools(s, world, 0, 1)
        place_shapes(s.tools, world, 0, 1)
        count_substep(s, world)

    def each(phase: Any) -> Any:
        """A kernel with a thread for each particle, which goes through `phase`."""

        @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
        def kernel(s: System):
            world, i = wp.tid()
            phase(s, global_memory(s.memory, world * ROWS * s.particles), world, i)

        return kernel

    def each_of_rows(phase: Any) -> Any:
        """The same of a phase that reads the rows from `source` on and writes the others."""

        @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
        def kernel(s: System, source: int):
            world, i = wp.tid()
            memory = global_memory(s.memory, world * ROWS * s.particles)
            phase(s, memory, world, i, source, s.particles - source)

        return kernel

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def density_kernel_(s: System, source: int):
        world, i = wp.tid()
        density(s, global_memory(s.memory, world * ROWS * s.particles), world, i, source)

    return Kernels(
        block=block_kernel,
        tools=tools_kernel,
        predict=each(predict),
        find=each(find),
        density=density_kernel_,
        solve=each_of_rows(solve),
        finish=each_of_rows(finish),
        viscosity=each_of_rows(viscosity),
    )
