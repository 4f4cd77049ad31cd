"""Where positions are while a block works: in its shared memory, their weights beside them if there is room, or in global memory."""

# What Warp compiles is not quite Python: see solver.py.

from dataclasses import dataclass
from typing import Any

import warp as wp

from understudy_cloth.world import Cloth, Features
from understudy_warp_torch.blocks import global_memory as global_address
from understudy_warp_torch.blocks import load_row, shared_memory, store_row
from understudy_warp_torch.shapes import xyz

packed_address = global_address(wp.vec3)


@wp.func_native("return ((const wp::vec_t<3, float>*)memory)[i];")
def load_packed(memory: wp.uint64, i: int) -> wp.vec3:
    """Vector `i` of those that lie one after the other."""


@wp.func_native("((wp::vec_t<3, float>*)memory)[i] = x;")
def store_packed(memory: wp.uint64, i: int, x: wp.vec3):
    """Write vector `i` of those that lie one after the other."""


# x, y and z apart, so that threads side by side read numbers side by side
@wp.func_native(
    """
    const float* of = (const float*)memory;
    return wp::vec_t<3, float>(of[i], of[n + i], of[2 * n + i]);
"""
)
def load_apart(memory: wp.uint64, n: int, i: int) -> wp.vec3:
    """Vector `i` of `n` whose x, y and z lie apart."""


@wp.func_native(
    """
    float* of = (float*)memory;
    of[i] = x[0];
    of[n + i] = x[1];
    of[2 * n + i] = x[2];
"""
)
def store_apart(memory: wp.uint64, n: int, i: int, x: wp.vec3):
    """Write vector `i` of `n` whose x, y and z lie apart."""


# of a vector and its weight, which are a row of blocks.load_row, the first three or the last
@wp.func_native(
    """
    float* of = (float*)memory + 4 * i;
    of[0] = x[0];
    of[1] = x[1];
    of[2] = x[2];
"""
)
def store_beside(memory: wp.uint64, i: int, x: wp.vec3):
    """Write vector `i`, not its weight."""


@wp.func_native("((float*)memory)[4 * i + 3] = weight;")
def store_weight(memory: wp.uint64, i: int, weight: float):
    """Write the weight of vector `i` alone."""


@dataclass(frozen=True)
class Memory:
    """How a phase reaches vertex `i` of the world that its address `m` is of."""

    address: Any  #: (positions, the world's first) → m, of a block
    load: Any  #: (m, cloth, i) → its position
    store: Any  #: (m, cloth, i, position)
    load_all: Any  #: (m, cloth, world, i) → its position and weight
    store_all: Any  #: (m, cloth, i, position, weight), the weight as it was
    weigh: Any  #: (m, i, weight)


def memory_of(features: Features) -> Memory:
    """Of the kernels of all scenes with these `features`."""
    SHARED = wp.constant(features.shared > 0)
    WEIGHTED = wp.constant(features.weighted)
    address = packed_address
    if features.weighted:
        address = shared_memory(wp.vec3, "float4", features.shared)
    elif features.shared:
        address = shared_memory(wp.vec3, "float", 3 * features.shared)

    @wp.func
    def load(m: wp.uint64, c: Cloth, i: int) -> wp.vec3:
        x = wp.vec3()
        if wp.static(WEIGHTED):
            x = xyz(load_row(m, i))
        elif wp.static(SHARED):
            x = load_apart(m, c.vertices, i)
        else:
            x = load_packed(m, i)
        return x

    @wp.func
    def store(m: wp.uint64, c: Cloth, i: int, x: wp.vec3):
        if wp.static(WEIGHTED):
            store_beside(m, i, x)
        elif wp.static(SHARED):
            store_apart(m, c.vertices, i, x)
        else:
            store_packed(m, i, x)

    @wp.func
    def load_all(m: wp.uint64, c: Cloth, world: int, i: int) -> wp.vec4:
        """Position and weight."""
        x = wp.vec4()
        if wp.static(WEIGHTED):
            x = load_row(m, i)
        else:
            y = load(m, c, i)
            x = wp.vec4(y[0], y[1], y[2], c.weight[world * c.vertices + i])
        return x

    @wp.func
    def store_all(m: wp.uint64, c: Cloth, i: int, x: wp.vec3, weight: float):
        """The weight is as it was."""
        if wp.static(WEIGHTED):
            store_row(m, i, wp.vec4(x[0], x[1], x[2], weight))
        else:
            store(m, c, i, x)

    @wp.func
    def weigh(m: wp.uint64, i: int, weight: float):
        if wp.static(WEIGHTED):
            store_weight(m, i, weight)

    return Memory(address, load, store, load_all, store_all, weigh)
