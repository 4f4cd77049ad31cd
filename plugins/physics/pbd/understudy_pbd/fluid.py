"""What fluids have besides: a density, and viscosity (Macklin and Müller 2013)."""

# variables that loops change are made with float(0.0), or Warp takes them for constants
# ruff: noqa: UP018

import warp as wp

from understudy_pbd.boundary import wall, wall_gradient
from understudy_pbd.constraints import density_kernel, density_slope, missing_density
from understudy_pbd.world import NEAR, System
from understudy_warp_torch.blocks import load_row, store_row
from understudy_warp_torch.shapes import xyz


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
                    r = wp.max(wp.sqrt(r2), NEAR)
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
        store_row(memory, 2 * s.particles + i, wp.vec4(begin[0], begin[1], begin[2], -c / squares))


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
