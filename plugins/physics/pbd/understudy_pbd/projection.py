"""The constraints on a particle, averaged: one Jacobi iteration."""

# variables that loops change are made with float(0.0), or Warp takes them for constants
# ruff: noqa: UP018, SIM102

from typing import Any

import warp as wp

from understudy_pbd.boundary import outside, wall_gradient
from understudy_pbd.constraints import contact, density_slope, spring
from understudy_pbd.world import FLUID_CONTACT, NEAR, Features, System
from understudy_warp_torch.blocks import load_row, store_row
from understudy_warp_torch.shapes import xyz


@wp.func
def share_of(share: float, power: float) -> float:
    """What an iteration corrects, so that all together correct `share` (Müller et al. 2007, 3.3)."""
    result = float(0.0)
    if share > 0.0:
        result = 1.0 - wp.pow(1.0 - share, power)
    return result


def solve_of(features: Features) -> Any:
    """The phase that an iteration is made of."""
    FLUIDS = wp.constant(features.fluids)
    SPRINGS = wp.constant(features.springs)
    ALIKE = wp.constant(features.alike)

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
                            r = wp.max(wp.sqrt(r2), NEAR)
                            lambdas = begin[3] / (s.inverse_mass[j] * rest)
                            lambdas += load_row(memory, 2 * s.particles + j)[3] / (w * density_j)
                            flow += (lambdas * w * density_slope(r, s.smoothing) / r) * apart
                        if flowing:
                            both = FLUID_CONTACT * both
                            static = 0.0
                            dynamic = 0.0
                            holds = 0.0
                limit = both
                if holds > 0.0:
                    limit = both * (1.0 + far)
                if r2 < limit * limit:
                    r = wp.sqrt(r2)
                    if r < NEAR:  # on each other: apart along z, each its own way
                        r = NEAR
                        apart = wp.vec3(0.0, 0.0, wp.where(i < j, -NEAR, NEAR))
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
                            r = wp.max(wp.length(apart), NEAR)
                            change = spring(apart, r, s.spring_length[world, i, k], s.stiffness)
                            share = w / (w + s.inverse_mass[j])
                            delta += (share * wp.min(own[3], other[3])) * change
                            active += 1.0
            x = outside(s, world, i, start, x + s.relaxation * delta + flow)
            own = wp.vec4(x[0], x[1], x[2], wp.min(own[3], 1.0 / wp.max(active, 1.0)))
        store_row(memory, target + i, own)

    return solve
