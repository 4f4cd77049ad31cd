"""Layers of cloth that touch each other."""

# What Warp compiles is not quite Python: see solver.py.
# ruff: noqa: UP018

from typing import Any, NamedTuple

import warp as wp

from understudy_cloth.contact import excess
from understudy_cloth.memory import Memory
from understudy_cloth.world import NEAR, Cloth
from understudy_warp_torch.shapes import friction


class Layers(NamedTuple):
    """Each a phase of one vertex: (cloth, m, world, vertex), in this order."""

    find: Any
    part: Any


def layers_of(memory: Memory) -> Layers:
    """Of cloth whose positions are in this `memory`."""
    load, store = memory.load, memory.store

    @wp.func
    def find_layers(c: Cloth, m: wp.uint64, world: int, i: int):
        """How other layers push vertex i, and rub on it."""
        o = world * c.vertices
        count = c.candidates[o + i]
        wi = c.weight[o + i]
        push = wp.vec3(0.0)
        shift = wp.vec3(0.0)
        if count > 0 and wi > 0.0:
            x = load(m, c, i)
            moved = x - c.start[o + i]
            rub = wp.vec3(0.0)
            others = wp.vec3(0.0)
            total = float(0.0)
            for k in range(count):
                j = c.candidate[world, i, k]
                y = load(m, c, j)
                apart = x - y
                r = wp.length(apart)
                if r < c.thickness:
                    if r < NEAR:  # on each other: apart along z, each its own way
                        r = NEAR
                        apart = wp.vec3(0.0, 0.0, wp.where(i < j, -NEAR, NEAR))
                    n = apart / r
                    share = wp.min(c.crowd[o + i], c.crowd[o + j]) * wi / (wi + c.weight[o + j])
                    theirs = y - c.start[o + j]
                    slip = moved - theirs
                    slip = slip - wp.dot(slip, n) * n
                    depth = c.thickness - r
                    mu = c.friction[world]
                    push += (share * depth) * n
                    rub += share * friction(slip, depth, mu, mu)
                    others += share * theirs
                    total += share
            if total > 0.0:
                size = wp.length(push)
                n = push / wp.max(size, NEAR)
                before = wp.dot(moved - others / total, n)
                shift = excess(before, size) * n
                push = push - rub
        c.push[o + i] = push
        c.shift[o + i] = shift

    @wp.func
    def part_layers(c: Cloth, m: wp.uint64, world: int, i: int):
        o = world * c.vertices + i
        if c.candidates[o] > 0 and c.weight[o] > 0.0:
            store(m, c, i, load(m, c, i) + c.push[o])
            c.start[o] = c.start[o] + c.shift[o]

    return Layers(find_layers, part_layers)
