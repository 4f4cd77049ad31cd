"""What holds cloth together: edges and pairs that keep their distance, and hinges that keep flat."""

# What Warp compiles is not quite Python: see solver.py.

from typing import Any, NamedTuple

import warp as wp

from understudy_cloth import mesh
from understudy_cloth.memory import Memory
from understudy_cloth.world import NEAR, Cloth
from understudy_warp_torch.shapes import xyz

#: Column of the fabric's stiffness.
BENDING = wp.constant(mesh.BENDING)


@wp.func
def softness(c: Cloth, world: int, kind: int) -> float:
    """Of a constraint with 1 m/N, over that of a vertex with 1 m²: ρ / (k Δt²)."""
    k = wp.max(c.stiffness[world, kind], 1e-12)
    return c.density[world] / (k * c.dt * c.dt)


@wp.func
def bending_substeps(c: Cloth, world: int) -> int:
    """For how many sub-steps hinges act in this one, 0: in none. What they do at once then is what they
    would do to the speed in all of them."""
    s = c.substep[world]
    return wp.where(s % c.bending_every == 0, wp.min(c.bending_every, c.substeps - s), 0)


class Constraints(NamedTuple):
    """Each a phase of one constraint: (cloth, m, world, constraint, its softness)."""

    keep_distance: Any
    keep_flat: Any


def constraints_of(memory: Memory) -> Constraints:
    """Of cloth whose positions are in this `memory`."""
    load_all, store_all = memory.load_all, memory.store_all

    @wp.func
    def keep_distance(c: Cloth, m: wp.uint64, world: int, k: int, soft: float):
        """XPBD with one iteration (Macklin et al. 2016, equation 18, with λ = 0), masses over density."""
        ends = c.pair[k]
        i = load_all(m, c, world, ends[0])
        j = load_all(m, c, world, ends[1])
        wi = i[3]
        wj = j[3]
        apart = xyz(i) - xyz(j)
        length = wp.length(apart)
        if length > NEAR and wi + wj > 0.0:
            share = (c.rest[k] - length) / (length * (wi + wj + soft * c.unit[k]))
            store_all(m, c, ends[0], xyz(i) + (share * wi) * apart, wi)
            store_all(m, c, ends[1], xyz(j) - (share * wj) * apart, wj)

    @wp.func
    def keep_flat(c: Cloth, m: wp.uint64, world: int, k: int, soft: float):
        """The same for the vector Σ weight_i x_i = 0, whose three components are apart."""
        ends = c.quad[k]
        a = c.quad_weight[k]
        x0 = load_all(m, c, world, ends[0])
        x1 = load_all(m, c, world, ends[1])
        x2 = load_all(m, c, world, ends[2])
        x3 = load_all(m, c, world, ends[3])
        w0 = x0[3] * a[0]
        w1 = x1[3] * a[1]
        w2 = x2[3] * a[2]
        w3 = x3[3] * a[3]
        total = w0 * a[0] + w1 * a[1] + w2 * a[2] + w3 * a[3] + soft * c.quad_unit[k]
        change = xyz(a[0] * x0 + a[1] * x1 + a[2] * x2 + a[3] * x3) / (-total)
        store_all(m, c, ends[0], xyz(x0) + w0 * change, x0[3])
        store_all(m, c, ends[1], xyz(x1) + w1 * change, x1[3])
        store_all(m, c, ends[2], xyz(x2) + w2 * change, x2[3])
        store_all(m, c, ends[3], xyz(x3) + w3 * change, x3[3])

    return Constraints(keep_distance, keep_flat)
