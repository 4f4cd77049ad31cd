"""What the person is made of: links, hinges, the places where it feels, and what cloth meets.

Sizes, masses, ranges and damping are those of the 2018 code (docs/papers/dressing.md). Metres, z up; the
person looks along x, its left is y, the base of its neck is the origin.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np

from understudy_warp_torch.tools import Shape, TaperedCapsule, Tool

Vector = tuple[float, float, float]
Side = Literal["left", "right"]
SIDES: tuple[Side, Side] = ("left", "right")
GRIPPER = "gripper"
FREE = 1e3  #: rad, of a hinge without limits
#: Friction of a body: with the fabric's 0.5, the mean is the 2018 code's.
_FRICTION = 0.5


@dataclass(frozen=True)
class Hinge:
    """A hinge with a motor."""

    name: str
    axis: Vector
    low: float  #: rad
    high: float  #: rad
    damping: float = 1.0  #: N m s
    torque: float = 12.0  #: N m, at an action of 1


@dataclass(frozen=True)
class Link:
    """A body, and the tapered capsules of it that cloth meets, each (radius, from, radius, to) in its frame."""

    name: str
    parent: str | None
    position: Vector  #: m, in the parent's frame
    mass: float  #: kg
    hinges: tuple[Hinge, ...]
    shapes: tuple[tuple[float, Vector, float, Vector], ...] = ()


#: In the hand's frame: the fingers' joint, the middle of the sphere at their end, which feels, and the fingertip that
#: tasks speak of, 75 mm from the joint (decision 85).
_FINGERS: Vector = (0.0, 0.0, -0.04)
_END: Vector = (0.0, 0.0, -0.10)
TIP: Vector = (0.0, 0.0, -0.115)


def _arm(side: Side) -> tuple[Link, ...]:
    s = 1.0 if side == "left" else -1.0  # of y, and of turns about x and z
    low, high = (-2.09, 1.0) if side == "left" else (-1.0, 2.09)
    out: Vector = (0.0, 0.21 * s, 0.0)

    def hinge(name: str, axis: Vector, low: float, high: float, damping: float = 1.0) -> Hinge:
        return Hinge(f"{side}_{name}", axis, low, high, damping)

    return (
        Link(f"{side}_clavicle", "spine", (0, 0, 0), 3.0, (
            hinge("clavicle_raise", (-s, 0, 0), -0.25, 0.25),
            hinge("clavicle_swing", (0, 0, s), -0.25, 0.25),
        ), ((0.07, (0, 0, 0), 0.065, out),)),
        Link(f"{side}_upper_arm", f"{side}_clavicle", out, 1.9, (
            hinge("shoulder_spread", (-s, 0, 0), -FREE, FREE, 0.1),
            hinge("shoulder_swing", (0, 1, 0), -FREE, FREE, 0.1),
            hinge("shoulder_twist", (0, 0, 1), low, high, 0.1),
        ), ((0.065, (0, 0, 0), 0.05, (0, 0, -0.30)),)),
        Link(f"{side}_forearm", f"{side}_upper_arm", (0, 0, -0.30), 1.0, (
            hinge("elbow", (0, -1, 0), 0.2, 2.9),
        ), ((0.05, (0, 0, 0), 0.0365, (0, 0, -0.35)),)),
        Link(f"{side}_hand", f"{side}_forearm", (0, 0, -0.35), 0.5, (
            hinge("wrist_bend", (-s, 0, 0), -0.6, 0.6),
            hinge("wrist_tilt", (0, -1, 0), -0.6, 0.6),
        ), (
            (0.0365, (0, 0, 0), 0.04, _FINGERS),
            (0.04, _FINGERS, 0.046, _END),
        )),
    )  # fmt: skip


#: Pelvis to head, then the arms.
_TRUNK = (
    Link("torso", None, (0, 0, -0.45), 30.0, (
        Hinge("torso_lean", (-1, 0, 0), -0.5, 0.5, torque=50.0),
        Hinge("torso_bend", (0, 1, 0), -0.5, 1.0, torque=50.0),
    ), ((0.15, (0, 0, 0), 0.07, (0, 0, 0.45)),)),
    Link("spine", "torso", (0, 0, 0.45), 0.01, (Hinge("spine_twist", (0, 0, 1), -1.0, 1.0),)),
    Link("neck", "spine", (0, 0, 0), 1.6, (
        Hinge("neck_lean", (-1, 0, 0), -0.6, 0.6), Hinge("neck_bend", (0, -1, 0), -0.6, 0.6),
    ), ((0.07, (0, 0, 0), 0.10, (0, 0, 0.15)),)),
    Link("head", "neck", (0, 0, 0.15), 4.0, (Hinge("head_turn", (0, 0, 1), -1.0, 1.0),),
         ((0.10, (0, 0, 0), 0.10, (0, 0, 0.175)),)),
)  # fmt: skip
LINKS = (*_TRUNK, *_arm("left"), *_arm("right"))


def limb(side: Side) -> tuple[tuple[str, Vector], ...]:
    """Fingertip, fingers, wrist, elbow, shoulder, base of the neck."""
    hand = f"{side}_hand"
    rest = (hand, f"{side}_forearm", f"{side}_upper_arm", f"{side}_clavicle")
    return ((hand, TIP), (hand, _FINGERS), *((name, (0.0, 0.0, 0.0)) for name in rest))


def sensors() -> tuple[tuple[str, Vector], ...]:
    """The 22 places on the medial axis where the person feels (section 6.3, equation 4), fingertips the last of each arm."""
    places: list[tuple[str, Vector]] = [
        ("torso", (0, 0, 0)), ("spine", (0, 0, 0)), ("head", (0, 0, 0)), ("head", (0, 0, 0.175)),
    ]  # fmt: skip
    for side in SIDES:
        upper, fore, hand = (f"{side}_{name}" for name in ("upper_arm", "forearm", "hand"))
        places += [(upper, (0, 0, -0.30 * share)) for share in (0.0, 0.33, 0.66)]
        places += [(fore, (0, 0, -0.35 * share)) for share in (0.0, 0.33, 0.66)]
        places += [(hand, (0, 0, 0)), (hand, _FINGERS), (hand, _END)]
    return tuple(places)


def radii() -> tuple[float, ...]:
    """m, of the person around each of :func:`sensors`."""
    arm = (0.065, 0.06, 0.055, 0.05, 0.0455, 0.041, 0.0365, 0.04, 0.046)
    return (0.15, 0.07, 0.10, 0.10, *arm, *arm)


def tools() -> tuple[Tool, ...]:
    """What cloth meets: a tool for each link with a shape, in their order, then the gripper, which has none."""

    def shape(ra: float, a: Vector, rb: float, b: Vector) -> Shape:
        way = np.subtract(b, a)
        length = float(np.linalg.norm(way))
        turn = np.array([length + way[2], -way[1], way[0], 0.0])  # from z to the way, half-way
        turn = turn / np.linalg.norm(turn) if way[2] > -length + 1e-9 else np.array([0, 1, 0, 0.0])
        middle = tuple(np.add(a, b) / 2)
        return TaperedCapsule((ra, rb), length / 2, middle, tuple(turn.tolist()))  # type: ignore[arg-type]

    bodies = [
        Tool(tuple(shape(*one) for one in link.shapes), friction=_FRICTION)
        for link in LINKS
        if link.shapes
    ]
    return (*bodies, Tool(()))


def tool_bodies() -> tuple[str, ...]:
    """The body that each of :func:`tools` follows."""
    return (*(link.name for link in LINKS if link.shapes), GRIPPER)
