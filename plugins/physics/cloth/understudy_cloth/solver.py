"""Cloth by extended position-based dynamics in small steps, N worlds: the phases of a sub-step, and two
ways to go through them.

Each phase is a function of one vertex, constraint or triangle of one world:

- search: what may touch (:mod:`~understudy_cloth.search`), every few sub-steps
- motion: tools, grips and gravity (:mod:`~understudy_cloth.motion`)
- constraints: edges and hinges (:mod:`~understudy_cloth.constraints`)
- layers that touch each other (:mod:`~understudy_cloth.layers`)
- contact with shapes (:mod:`~understudy_cloth.contact`), and the new velocity

:func:`build_kernels` makes of them

- ``block``: one kernel for any number of sub-steps, a thread block for each world. Positions stay in
  shared memory if they fit. On the CPU a block has one thread.
- one kernel for each phase and colour with a thread for each of its items, the same numbers by launches.

No result depends on the order of threads: constraints of a colour share no vertex, and everything else
reads others and writes its own.
"""

# What Warp compiles is not quite Python: variables that loops change are made with float(0.0), and
# conditions known when compiling stand alone.
# ruff: noqa: UP018, SIM102

import functools
from dataclasses import dataclass
from typing import Any

import warp as wp

from understudy_cloth.constraints import BENDING, bending_substeps, constraints_of, softness
from understudy_cloth.contact import contact_of
from understudy_cloth.layers import layers_of
from understudy_cloth.memory import memory_of, packed_address
from understudy_cloth.motion import count_substep, motion_of, move_tools
from understudy_cloth.search import search_of, searches
from understudy_cloth.world import Cloth, Features
from understudy_warp_torch.blocks import wait_for_block
from understudy_warp_torch.shapes import place_shapes

#: Division and roots to 2 bits less, on CUDA.
_FAST = {"fast_math": True}


@dataclass(frozen=True)
class Kernels:
    """What is launched, each with its arguments and its number of threads."""

    block: Any  #: (cloth, sub-steps), tiled by worlds
    #: (cloth, whether this resumes), (N, buckets, vertices or shapes, whichever is most)
    begin: Any
    insert: Any  #: (cloth, whether this resumes), (N, V or F)
    search: Any  #: (cloth, whether this resumes), (N, V)
    tools: Any  #: (cloth,), N
    grip: Any  #: (cloth,), (N, U)
    predict: Any  #: (cloth,), (N, V)
    edges: Any  #: (cloth, colour, its first edge), (N, edges)
    hinges: Any  #: (cloth, colour, its first hinge), (N, hinges)
    find_layers: Any  #: (cloth,), (N, V)
    part_layers: Any  #: (cloth,), (N, V)
    touch: Any  #: (cloth,), (N, F)
    finish: Any  #: (cloth,), (N, V)
    count: Any  #: (cloth,), N
    judge: Any  #: (cloth,), (N, V)


@functools.cache
def build_kernels(features: Features) -> Kernels:
    """The kernels of all scenes with these `features`."""
    SHAPES = wp.constant(features.shapes)
    GRIPS = wp.constant(features.grips)
    LAYERS = wp.constant(features.self_contact)
    SHARED = wp.constant(features.shared > 0)
    LANES = features.threads
    memory = memory_of(features)
    address, load, store_all = memory.address, memory.load, memory.store_all
    begin_search, insert, search = search_of(features, memory)
    keep_distance, keep_flat = constraints_of(memory)
    find_layers, part_layers = layers_of(memory)
    contact = contact_of(memory)
    touch = contact.touch
    grip, predict, finish, judge = motion_of(features, memory, contact)

    # so few registers that a multiprocessor holds as many blocks as make 1024 threads
    bounds = (LANES, max(1, 1024 // LANES))

    @wp.kernel(module="unique", enable_backward=False, launch_bounds=bounds, module_options=_FAST)
    def block_kernel(c: Cloth, count: int):
        world, lane = wp.tid()
        lanes = wp.block_dim()
        n = c.vertices
        m = address(c.position, world * n)
        if wp.static(SHARED):
            for i in range(lane, n, lanes):
                store_all(m, c, i, c.position[world * n + i], c.weight[world * n + i])
            wait_for_block()
        # of what was searched, the layers' candidates are no state: they follow from anchors again
        resumes = bool(False)
        if wp.static(LAYERS):
            resumes = c.substep[world] % c.every != 0
        for _substep in range(count):
            if wp.static(LAYERS or SHAPES):
                if resumes or c.substep[world] % c.every == 0:
                    for k in range(lane, wp.max(wp.max(n, c.buckets), c.tools.shapes), lanes):
                        begin_search(c, m, world, k, resumes)
                    wait_for_block()
                    for k in range(lane, wp.max(n, c.faces), lanes):
                        insert(c, m, world, k, resumes)
                    wait_for_block()
                    for i in range(lane, n, lanes):
                        search(c, m, world, i, resumes)
                    resumes = False
            if wp.static(SHAPES or GRIPS):
                wait_for_block()
                move_tools(c, world, lane, lanes)
                wait_for_block()
                place_shapes(c.tools, world, lane, lanes)
            if wp.static(GRIPS):
                for u in range(lane, c.grip_vertices, lanes):
                    grip(c, m, world, u)
            wait_for_block()
            for i in range(lane, n, lanes):
                predict(c, m, world, i)
            wait_for_block()
            for colour in range(c.colours):
                soft = softness(c, world, c.kind[colour])
                for k in range(c.first[colour] + lane, c.first[colour + 1], lanes):
                    keep_distance(c, m, world, k, soft)
                wait_for_block()
            bends = bending_substeps(c, world)
            if bends > 0:
                soft = softness(c, world, BENDING) / float(bends)
                for colour in range(c.quad_colours):
                    for k in range(c.quad_first[colour] + lane, c.quad_first[colour + 1], lanes):
                        keep_flat(c, m, world, k, soft)
                    wait_for_block()
            if wp.static(LAYERS):
                for i in range(lane, n, lanes):
                    find_layers(c, m, world, i)
                wait_for_block()
                for i in range(lane, n, lanes):
                    part_layers(c, m, world, i)
                wait_for_block()
            if wp.static(SHAPES):
                for f in range(lane, c.faces, lanes):
                    touch(c, m, world, f)
                wait_for_block()
            for i in range(lane, n, lanes):
                finish(c, m, world, i)
            if lane == 0:
                count_substep(c, world)
            wait_for_block()
        for i in range(lane, n, lanes):
            judge(c, m, world, i)
            if wp.static(SHARED):
                c.position[world * n + i] = load(m, c, i)

    def each(phase: Any) -> Any:
        """A kernel with a thread for each item of `phase`, which goes through it."""

        @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
        def kernel(c: Cloth):
            world, i = wp.tid()
            phase(c, packed_address(c.position, world * c.vertices), world, i)

        return kernel

    def each_of_search(phase: Any) -> Any:
        """The same of a phase of the search, where one is due or, as state is set, `resumes`."""

        @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
        def kernel(c: Cloth, resumes: bool):
            world, k = wp.tid()
            if searches(c, world, resumes):
                phase(c, packed_address(c.position, world * c.vertices), world, k, resumes)

        return kernel

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def tools_kernel(c: Cloth):
        world = wp.tid()
        move_tools(c, world, 0, 1)
        place_shapes(c.tools, world, 0, 1)

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def edges_kernel(c: Cloth, colour: int, first: int):
        world, k = wp.tid()
        m = packed_address(c.position, world * c.vertices)
        keep_distance(c, m, world, first + k, softness(c, world, c.kind[colour]))

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def hinges_kernel(c: Cloth, colour: int, first: int):
        world, k = wp.tid()
        m = packed_address(c.position, world * c.vertices)
        bends = bending_substeps(c, world)
        if bends > 0:
            keep_flat(c, m, world, first + k, softness(c, world, BENDING) / float(bends))

    @wp.kernel(module="unique", enable_backward=False, module_options=_FAST)
    def count_kernel(c: Cloth):
        count_substep(c, wp.tid())

    return Kernels(
        block=block_kernel,
        begin=each_of_search(begin_search),
        insert=each_of_search(insert),
        search=each_of_search(search),
        tools=tools_kernel,
        grip=each(grip),
        predict=each(predict),
        edges=edges_kernel,
        hinges=hinges_kernel,
        find_layers=each(find_layers),
        part_layers=each(part_layers),
        touch=each(touch),
        finish=each(finish),
        count=count_kernel,
        judge=each(judge),
    )
