"""The formulas of the solver, for one pair or one particle; who calls them in which order is in
:mod:`understudy_pbd.solver`."""

# What Warp compiles is not quite Python: variables that loops change are made with float(0.0), and
# conditions known when compiling stand alone.

import warp as wp

from understudy_warp_torch.shapes import friction


@wp.func
def contact(
    apart: wp.vec3,
    distance: float,
    touching: float,
    slip: wp.vec3,
    static: float,
    dynamic: float,
    cohesion: float,
) -> wp.vec3:
    """How the vector `apart` between two particles is to change.

    Nearer than `touching` they are pushed apart, with friction against the relative displacement
    `slip`; else the share `cohesion` of the gap is closed.
    """
    n = apart * (1.0 / distance)
    depth = touching - distance
    if depth <= 0.0:
        return cohesion * depth * n
    return depth * n - friction(slip - wp.dot(slip, n) * n, depth, static, dynamic)


@wp.func
def spring(apart: wp.vec3, distance: float, length: float, stiffness: float) -> wp.vec3:
    """How `apart` is to change towards the rest length (distance constraint)."""
    return (stiffness * (length - distance) / distance) * apart


@wp.func
def density_kernel(r2: float, h: float) -> float:
    """W, poly6 (Müller et al. 2003), 1/m³, at the squared distance `r2` < h²."""
    h2 = h * h
    a = h2 - r2
    return 315.0 / (64.0 * wp.pi) * (a / h2) * (a / h2) * (a / h2) / (h2 * h)


@wp.func
def density_slope(distance: float, h: float) -> float:
    """dW/dr of the spiky kernel (Müller et al. 2003), 1/m⁴; negative."""
    a = (h - distance) / h
    return -45.0 / wp.pi * a * a / (h * h * h * h)


@wp.func
def missing_density(distance: float, h: float) -> float:
    """∫W over the half-space beyond a wall at `distance`: the share of the rest density that a
    particle there misses. A half at the wall, 0 from h on."""
    q = wp.clamp(distance / h, 0.0, 1.0)
    q2 = q * q
    f = q * (1.0 + q2 * (-4.0 / 3.0 + q2 * (6.0 / 5.0 + q2 * (-4.0 / 7.0 + q2 / 9.0))))
    return 0.5 - 315.0 / 256.0 * f


@wp.func
def missing_slope(distance: float, h: float) -> float:
    """The derivative of :func:`missing_density`, 1/m; negative."""
    q = wp.clamp(distance / h, 0.0, 1.0)
    a = 1.0 - q * q
    return -315.0 / 256.0 * a * a * a * a / h
