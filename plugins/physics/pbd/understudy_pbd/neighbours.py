"""Who is near whom."""

# variables that loops change are made with int(0), or Warp takes them for constants
# ruff: noqa: UP018, RUF046, SIM102

from typing import Any

import warp as wp

from understudy_pbd.world import FLUID_CONTACT, Features, System
from understudy_warp_torch.blocks import load_row, store_row
from understudy_warp_torch.shapes import xyz


def find_of(features: Features) -> Any:
    """The phase that looks for neighbours."""
    FLUIDS = wp.constant(features.fluids)
    SPRINGS = wp.constant(features.springs)
    ALIKE = wp.constant(features.alike)

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
                            both = FLUID_CONTACT * both
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

    return find
