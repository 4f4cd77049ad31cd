"""What kernels need that give a world one thread block: its shared memory, rows of it, and waiting for each other.

On the CPU a block has one thread: there is nothing to wait for, and memory is global.
"""

from functools import cache
from typing import Any

import warp as wp

__all__ = ["global_memory", "load_row", "shared_memory", "store_row", "wait_for_block"]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""
)
def wait_for_block():
    """Wait until all threads of the block are here."""


# rows of four numbers, which on a GPU are read and written at once
@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    const float4 of = ((const float4*)memory)[row];
    return wp::vec_t<4, float>(of.x, of.y, of.z, of.w);
#else
    return ((const wp::vec_t<4, float>*)memory)[row];
#endif
"""
)
def load_row(memory: wp.uint64, row: int) -> wp.vec4:  # type: ignore
    """Row `row` of the vectors that lie one after the other from the address `memory` on."""


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    ((float4*)memory)[row] = make_float4(value[0], value[1], value[2], value[3]);
#else
    ((wp::vec_t<4, float>*)memory)[row] = value;
#endif
"""
)
def store_row(memory: wp.uint64, row: int, value: wp.vec4):  # type: ignore
    """Write row `row` of them."""


@cache
def global_memory(dtype: Any) -> Any:
    """A function of an array of `dtype` and an index, which gives the address there."""

    @wp.func_native("return (uint64_t)(memory.data + offset);")
    def address(memory: wp.array(dtype=dtype), offset: int) -> wp.uint64: ...  # type: ignore

    return address


@cache
def shared_memory(dtype: Any, cuda_type: str, count: int) -> Any:
    """The same function, but on a GPU it gives the address of `count` of CUDA's `cuda_type` in the
    memory that the threads of a block share. Warp takes 1 of its 48 KiB."""

    snippet = f"""
#if defined(__CUDA_ARCH__)
    __shared__ {cuda_type} shared[{count}];
    return (uint64_t)(void*)shared;
#else
    return (uint64_t)(memory.data + offset);
#endif
"""

    @wp.func_native(snippet)
    def address(memory: wp.array(dtype=dtype), offset: int) -> wp.uint64: ...  # type: ignore

    return address
