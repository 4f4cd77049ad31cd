"""The first and the last phase of a sub-step: where particles would go, and what velocity they got."""

# variables that loops change are made with float(0.0), or Warp takes them for constants
# ruff: noqa: UP018

from typing import Any

import warp as wp

from understudy_pbd.boundary import count_contact, swept
from understudy_pbd.world import Features, System
from understudy_warp_torch.blocks import load_row, store_row
from understudy_warp_torch.shapes import advance_tools, xyz


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


def finish_of(features: Features) -> Any:
    """The phase that ends a sub-step."""
    FLUIDS = wp.constant(features.fluids)

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

    return finish
