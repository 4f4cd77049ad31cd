"""Position-based dynamics of N worlds: the phases of a sub-step, and two ways to go through them.

Each phase is a function of one particle of one world, which reads others and writes only its own:

- predict: where it would go (:mod:`~understudy_pbd.motion`)
- find: who is near (:mod:`~understudy_pbd.neighbours`)
- density of fluids (:mod:`~understudy_pbd.fluid`) and solve, the constraints (:mod:`~understudy_pbd.projection`),
  by turns; the latter ends outside of tools and table (:mod:`~understudy_pbd.boundary`)
- finish: the new velocity (:mod:`~understudy_pbd.motion`), and viscosity of fluids

:func:`build_kernels` makes of them

- ``block``: one kernel for any number of sub-steps, a thread block for each world. Positions stay in
  shared memory if they fit. On the CPU a block has one thread.
- one kernel for each phase with a thread for each particle, the same numbers by launches.

The kernels are specialised: what a scene does not have costs nothing.
"""

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from understudy_pbd.fluid import density, viscosity
from understudy_pbd.motion import count_substep, finish_of, move_tools, predict
from understudy_pbd.neighbours import find_of
from understudy_pbd.projection import solve_of
from understudy_pbd.world import ROWS, Features, System
from understudy_warp_torch.blocks import global_memory as global_address
from understudy_warp_torch.blocks import shared_memory, wait_for_block
from understudy_warp_torch.shapes import place_shapes

#: Division and roots to 2 bits less, on CUDA.
_FAST = {"fast_math": True}

global_memory = global_address(wp.vec4)


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


@functools.cache
def build_kernels(features: Features) -> Kernels:
    """The kernels of all scenes with these `features`."""
    FLUIDS = wp.constant(features.fluids)
    LANES = features.threads
    block_memory = (
        shared_memory(wp.vec4, "float4", ROWS * features.shared)
        if features.shared
        else global_memory
    )
    find = find_of(features)
    solve = solve_of(features)
    finish = finish_of(features)

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
