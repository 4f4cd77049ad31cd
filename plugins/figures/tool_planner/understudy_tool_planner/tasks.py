"""Random tasks: objects of table 5.2 on the table, one of which is to be moved."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Generator, Tensor

from understudy_tool_planner.objects import KINDS, LENGTH, RADIUS, SIDE, Shape, Things
from understudy_tool_planner.planner import Task

#: m: where objects begin and where they are put (the release); and how far the spheres around two are apart.
START, GOAL, APART = ((-0.075, 0.075), (-0.075, 0.0)), ((-0.075, 0.075), (-0.05, 0.0)), 0.01
#: m: others may lie so much farther out.
_WIDER = 0.1


@dataclass(frozen=True)
class Layout:
    """A task, and what lies beside."""

    task: Task
    others: Things


def random_shape(generator: Generator) -> Shape:
    """Of each kind as often, sizes evenly within table 5.2."""
    kind = KINDS[int(torch.randint(len(KINDS), (1,), generator=generator))]
    ranges = {"sphere": (RADIUS,), "capsule": (RADIUS, LENGTH), "box": (SIDE, SIDE, SIDE)}[kind]
    return Shape(kind, tuple(_draw(r, generator) for r in ranges))


def random_layout(generator: Generator, others: int = 7) -> Layout:
    """One to be moved among so many `others`, none nearer than :data:`APART` to another or to the goal."""
    shape = random_shape(generator)
    start, goal = _place(START, generator), _place(GOAL, generator)
    taken = [(start, shape.reach), (goal, shape.reach)]
    shapes: list[Shape] = []
    places, headings = [], []
    region = tuple((low - _WIDER, high + _WIDER) for low, high in START)
    while len(shapes) < others:
        one, at = random_shape(generator), _place(region, generator)
        if all(math.dist(at, p) >= one.reach + r + APART for p, r in taken):
            shapes.append(one)
            places.append(at)
            headings.append(_draw((0.0, 0.5 * math.pi), generator))
            taken.append((at, one.reach))
    heading = _draw((0.0, 0.25 * math.pi if shape.kind == "capsule" else 0.5 * math.pi), generator)
    things = Things.of(
        shapes,
        torch.tensor(places, dtype=torch.float64).reshape(-1, 2),
        torch.tensor(headings, dtype=torch.float64),
    )
    return Layout(Task(shape, start, goal, heading), things)


def _place(region: tuple[tuple[float, float], ...], generator: Generator) -> tuple[float, float]:
    x, y = (_draw(r, generator) for r in region)
    return x, y


def _draw(ends: tuple[float, float], generator: Generator) -> float:
    low, high = ends
    share: Tensor = torch.rand((), generator=generator, dtype=torch.float64)
    return low + (high - low) * float(share)
