"""What kernels need that give a world one thread block: its shared memory, and waiting for each other.

On the CPU a block has one thread: there is nothing to wait for, and memory is global.
"""

from functools import cache
from typing import Any

import warp as wp

__all__ = ["global_memory", "shared_memory", "wait_for_block"]


@wp.func_native(
    """
#if defined(__CUDA_ARCH__)
    __syncthreads();
#endif
"""
)
def wait_for_block():
    """Wait until all threads of the block are here."""


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
