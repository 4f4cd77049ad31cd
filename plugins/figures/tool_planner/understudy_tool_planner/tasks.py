"""Random tasks: objects of table 5.2 on the table, which are moved one after another."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

import torch
from torch import Generator, Tensor

from understudy_tool_planner.objects import KINDS, LENGTH, RADIUS, SIDE, Shape, Things
from understudy_tool_planner.planner import Task

__all__ = ["APART", "Table", "random_goal", "random_shape"]

Point = tuple[float, float]
#: m: where objects begin and where they are put. The release's regions, of 15 × 7.5 and 15 × 5 cm, hold one in play;
#: eight at once need more room.
REGION = ((-0.125, 0.125), (-0.125, 0.05))
#: m: how far the spheres around two are apart.
APART = 0.01
_TRIES = 1000


@dataclass(frozen=True)
class Table:
    """Objects that lie on the table."""

    shapes: tuple[Shape, ...]
    places: tuple[Point, ...]  #: m
    headings: tuple[float, ...]  #: rad

    def without(self, one: int) -> Things:
        """What stays when number `one` is moved."""
        rest = [k for k in range(len(self.shapes)) if k != one]
        places = torch.tensor([self.places[k] for k in rest], dtype=torch.float64)
        headings = torch.tensor([self.headings[k] for k in rest], dtype=torch.float64)
        return Things.of([self.shapes[k] for k in rest], places.reshape(-1, 2), headings)

    def moved(self, one: int, goal: Point) -> Table:
        """With number `one` at `goal`."""
        places = (*self.places[:one], goal, *self.places[one + 1 :])
        return replace(self, places=places)

    def task(self, one: int, goal: Point, upon: float = 0.0) -> Task:
        """To move number `one` to `goal`, onto something that is `upon` m high."""
        return Task(self.shapes[one], self.places[one], goal, self.headings[one], upon=upon)


def random_shape(generator: Generator) -> Shape:
    """Of each kind as often, sizes evenly within table 5.2."""
    kind = KINDS[int(torch.randint(len(KINDS), (1,), generator=generator))]
    ranges = {"sphere": (RADIUS,), "capsule": (RADIUS, LENGTH), "box": (SIDE, SIDE, SIDE)}[kind]
    return Shape(kind, tuple(_draw(r, generator) for r in ranges))


def random_table(generator: Generator, count: int = 8) -> Table:
    """So many objects, none nearer than :data:`APART` to another."""
    shapes: list[Shape] = []
    places: list[Point] = []
    headings: list[float] = []
    for _ in range(count):
        shape = random_shape(generator)
        places.append(_free(shape, shapes, places, generator))
        shapes.append(shape)
        most = 0.25 * math.pi if shape.kind == "capsule" else 0.5 * math.pi
        headings.append(_draw((0.0, most), generator))
    return Table(tuple(shapes), tuple(places), tuple(headings))


def random_goal(table: Table, one: int, generator: Generator) -> Point:
    """A place for number `one` that is free of all others."""
    rest = [k for k in range(len(table.shapes)) if k != one]
    shapes, places = [table.shapes[k] for k in rest], [table.places[k] for k in rest]
    return _free(table.shapes[one], shapes, places, generator)


def _free(
    shape: Shape, shapes: Sequence[Shape], places: Sequence[Point], generator: Generator
) -> Point:
    for _ in range(_TRIES):
        x, y = (_draw(r, generator) for r in REGION)
        if all(
            math.dist((x, y), at) >= shape.reach + other.reach + APART
            for other, at in zip(shapes, places, strict=True)
        ):
            return x, y
    raise ValueError(f"{len(shapes) + 1} objects have no room on the table: take fewer.")


def _draw(ends: tuple[float, float], generator: Generator) -> float:
    low, high = ends
    share: Tensor = torch.rand((), generator=generator, dtype=torch.float64)
    return low + (high - low) * float(share)
