"""Scenes that several tests use."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

from sheets import along, sheet

from understudy_cloth.scene import Box, Capsule, ClothModel, Fabric, Grip, TaperedCapsule, Tool

ARM = Tool(
    (
        TaperedCapsule((0.05, 0.0365), **along(((0, 0, 0), (0.3, 0, 0)))),
        Capsule(0.04, **along(((0.3, 0, 0), (0.36, 0, 0)))),
    ),
    (-0.1, 0.1, -0.1),
    friction=0.5,
)
FLOOR = Tool((Box((1.0, 1.0, 0.05)),), (0.0, 0.0, -0.25), friction=0.5)


def hung(**changes: Any) -> ClothModel:
    """A sheet on two corners."""
    x, faces = sheet(9, 9)
    return ClothModel(x, faces, **{"pinned": (0, 8), **changes})


def everything() -> ClothModel:
    """A sheet over an arm and a floor, with two grips of the arm that share a vertex."""
    x, faces = sheet(10, 12)
    grips = (Grip(0, (0, 1, 10)), Grip(1, (1, 2, 3)))
    return ClothModel(x, faces, Fabric(shear=1e3), pinned=(119,), tools=(ARM, FLOOR), grips=grips)


MODELS: dict[str, Callable[[], ClothModel]] = {
    "hung": hung,
    "everything": everything,
    "over an arm": lambda: hung(pinned=(), tools=(ARM,)),
}
