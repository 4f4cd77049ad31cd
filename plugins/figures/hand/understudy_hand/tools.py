"""What a hand holds: two sticks, tongs, or a brush (thesis, sections 5.6.1, 5.7 and 5.7.4).

A tool's frame has its origin in the middle and x along it; the tip is at -x. As a planner sees sticks and
tongs, they are a gripper of seven degrees of freedom: the lower part's pose, and an angle about its z axis.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import mujoco
import torch
from torch import Tensor

from understudy.options import check_range
from understudy_mujoco.forms import KINDS, Forms, lie_along_x
from understudy_tensors import rotations

__all__ = [
    "BAR",
    "GRIPPERS",
    "HALF_LENGTH",
    "RADIUS",
    "STICKS",
    "TIP",
    "Thing",
    "Tool",
    "mujoco_sizes",
    "tips",
    "upper_pose",
]

Tool = Literal["sticks", "tongs", "brush", "none"]

#: m: half of a stick without its caps, and its radius (thesis: 26 cm, 0.4 cm).
HALF_LENGTH, RADIUS = 0.13, 0.004
#: m: a bar of the tongs is 26 × 0.8 × 2 cm (section 5.7.4); its broad side is across the opening.
BAR = (0.13, 0.004, 0.01)
#: N m/rad and rad of the tongs' spring.
STIFFNESS, REST = 20.0, 0.2
#: kg m², on all six coordinates of a stick: more than its own, so that a step of 5 ms can hold it still.
ARMATURE = 1e-4
#: Of the tip of a tool, in its frame, m.
TIP = (-HALF_LENGTH, 0.0, 0.0)
#: m: how far around it a contact counts as one of a tool's tip.
_TOUCH = 0.015
_DENSITY = 1000.0
#: Of the upper and the lower part.
_WOOD = ((0.80, 0.58, 0.30, 1.0), (0.55, 0.27, 0.15, 1.0))
_STEEL, _HANDLE = (0.62, 0.65, 0.70, 1.0), (0.45, 0.20, 0.12, 1.0)
_FRUIT, _LEAF = (0.85, 0.25, 0.22, 1.0), (0.36, 0.55, 0.30, 1.0)
#: What an object is where worlds differ in it (thesis, table 5.2), and m: how high the middle of the tallest is.
FORMS: tuple[str, ...] = ("sphere", "capsule", "box")
_TALLEST = 0.01
#: Names of the bodies, the upper one first.
BODIES: dict[Tool, tuple[str, ...]] = {
    "sticks": ("upper_stick", "lower_stick"),
    "tongs": ("upper_bar", "lower_bar"),
    "brush": ("brush",),
    "none": (),
}


@dataclass(frozen=True)
class Gripper:
    """How the two parts of a tool hang together."""

    #: m: about which the upper part turns, in the lower one's frame
    pivot: tuple[float, float, float]
    along: float  #: m: where that is on the upper part
    axis: tuple[float, float, float]  #: in the lower part's frame
    zero: float = 0.0  #: rad: how far the upper part is turned where the angle is 0


#: Sticks are parallel at 0, 35 mm apart, and their tips nearer to each other above it (the release).
STICKS = Gripper((0.045, 0.035, 0.0), 0.045, (0.0, 0.0, 1.0))
#: Tongs turn about their ends. At 0 they are as open as the spring has them, above it their tips are nearer
#: to each other; they are shut at the spring's rest. (The hinge ``opening`` is 0 where they are shut.)
TONGS = Gripper((0.13, 0.008, 0.0), 0.13, (0.0, 0.0, 1.0), -REST)
#: By tool of two parts.
GRIPPERS: dict[Tool, Gripper] = {"sticks": STICKS, "tongs": TONGS}


def upper_pose(
    position: Tensor, rotation: Tensor, angle: Tensor, gripper: Gripper = STICKS
) -> tuple[Tensor, Tensor]:
    """Where the upper part of a gripper is: its middle (…, 3) m and rotation (…, 4).

    Parameters
    ----------
    position, rotation
        (…, 3) m and (…, 4) of the lower part, in any frame.
    angle
        (…) rad, by which they are closed.
    gripper
        how they hang together.
    """
    # From numbers, so that a step that is captured makes no tensors of them.
    half = 0.5 * (angle + gripper.zero)
    sine, cosine = half.sin(), half.cos()
    turn = torch.stack([cosine, *(part * sine for part in gripper.axis)], dim=-1)
    turned = rotations.multiply(rotation, turn)
    axes, along = rotations.to_matrix(rotation), rotations.to_matrix(turned)[..., 0]
    pivot = sum(axes[..., k] * part for k, part in enumerate(gripper.pivot))
    return position + pivot - gripper.along * along, turned


def add(spec: mujoco.MjSpec, tool: Tool, friction: float, contact: tuple[int, int]) -> None:
    """Add the tool `tool` to `spec`, with the contact masks (type, affinity), lying somewhere in the air."""
    if tool == "sticks":
        for name, y, wood in zip(BODIES[tool], (0.0, -STICKS.pivot[1]), _WOOD, strict=True):
            body = spec.worldbody.add_body(name=name, pos=[-0.07, y, 0.14])
            body.add_freejoint(name=name).armature = ARMATURE
            _shape(body, name, mujoco.mjtGeom.mjGEOM_CAPSULE, (RADIUS, HALF_LENGTH, 0.0), wood)
    elif tool == "tongs":
        upper, lower = BODIES[tool]
        body = spec.worldbody.add_body(name=lower, pos=[-0.07, 0.0, 0.14])
        body.add_freejoint(name=lower).armature = ARMATURE
        _shape(body, lower, mujoco.mjtGeom.mjGEOM_BOX, BAR, _STEEL)
        x, y, z = TONGS.pivot
        other = body.add_body(name=upper, pos=[x - TONGS.along, y, z])
        hinge = other.add_joint(
            name="opening", axis=[0, 0, -1], pos=[TONGS.along, 0, 0], range=[0, 0.6], limited=True
        )
        hinge.stiffness[0], hinge.springref, hinge.armature = STIFFNESS, REST, ARMATURE
        _shape(other, upper, mujoco.mjtGeom.mjGEOM_BOX, BAR, _STEEL)
    elif tool == "brush":
        (name,) = BODIES[tool]
        body = spec.worldbody.add_body(name=name, pos=[-0.07, 0.0, 0.14])
        body.add_freejoint(name=name).armature = ARMATURE
        _shape(body, name, mujoco.mjtGeom.mjGEOM_CAPSULE, (RADIUS, HALF_LENGTH, 0.0), _HANDLE)
    for body in spec.bodies:
        if body.name in BODIES[tool]:
            for geom in body.geoms:
                geom.contype, geom.conaffinity = contact
                geom.friction = [friction, 0.005, 0.0001]


@dataclass(frozen=True)
class Thing:
    """An object on the table, free to move."""

    #: its form; a capsule lies along x; ``any`` is another of these in each world
    kind: Literal["sphere", "capsule", "box", "any"] = "sphere"
    #: m: radius of a sphere; radius and length (of the cylinder) of a capsule; the three sides of a box; none of ``any``
    sizes: tuple[float, ...] = (0.01,)
    density: float = 1000.0  #: kg/m³, of the sticks' wood and the hand alike
    #: sliding, with whatever it touches; null is the scene's (figure 5.21 varies it)
    friction: float | None = None
    #: m, of rolling friction: a sphere that has none rolls on for ever (the release)
    rolling: float = 0.0

    def __post_init__(self) -> None:
        check_range(self, "density", most=1e5)
        count = {"sphere": 1, "capsule": 2, "box": 3, "any": 0}[self.kind]
        if len(self.sizes) != count:
            raise ValueError(
                f"sizes={list(self.sizes)} are not possible: kind={self.kind} has {count} of them."
            )
        check_range(self, "sizes", least=1e-3, most=1.0)
        check_range(self, "density", "friction", above=0)
        check_range(self, "rolling", least=0, most=0.01)

    @property
    def height(self) -> float:
        """m: of the middle above what it lies on; of what is any, of the tallest."""
        if self.kind == "any":
            return _TALLEST
        return 0.5 * self.sizes[2] if self.kind == "box" else self.sizes[0]

    @property
    def forms(self) -> Forms | None:
        """What ``object`` may be, where worlds differ in it."""
        return Forms("object", FORMS, self.density) if self.kind == "any" else None


def add_thing(
    spec: mujoco.MjSpec, name: str, thing: Thing, friction: float, contact: tuple[int, int]
) -> None:
    """Add the body `name`, on the table and out of the hand's way, with the contact masks (type, affinity)."""
    y = {"object": 0.25, "below": 0.15, "above": 0.05}[name]
    body = spec.worldbody.add_body(name=name, pos=[-0.5, y, thing.height])
    body.add_freejoint(name=name)
    sliding = friction if thing.friction is None else thing.friction
    options = {
        "contype": contact[0], "conaffinity": contact[1],
        "condim": 6 if thing.rolling > 0 else 4, "friction": [sliding, 0.005, thing.rolling or 0.0001],
        # Of two frictions the larger one counts, unless one has priority.
        "priority": int(thing.friction is not None), "rgba": _FRUIT if name == "object" else _LEAF,
    }  # fmt: skip
    if thing.kind == "any":
        Forms(name, FORMS, thing.density).add(body, **options)
        return
    size = mujoco_sizes(thing.kind, thing.sizes)
    geom = body.add_geom(
        name=name, type=KINDS[thing.kind], size=size, density=thing.density, **options
    )
    lie_along_x(geom)


def mujoco_sizes(kind: str, sizes: tuple[float, ...]) -> tuple[float, ...]:
    """m (3,): of an object of those `sizes` as MuJoCo has them, which halves lengths."""
    if kind == "box":
        return tuple(0.5 * side for side in sizes)
    radius, *length = sizes
    return (radius, 0.5 * length[0] if length else 0.0, 0.0)


def _shape(
    body: mujoco.MjsBody,
    name: str,
    kind: mujoco.mjtGeom,
    size: tuple[float, float, float],
    colour: tuple[float, float, float, float],
) -> None:
    geom = body.add_geom(name=name, type=kind, size=size, density=_DENSITY, condim=4, rgba=colour)
    lie_along_x(geom)
    body.add_site(name=f"{name}_tip", pos=TIP, size=[0.002] * 3, group=4)
    body.add_site(name=f"touch_{name}_tip", pos=TIP, size=[_TOUCH] * 3, group=4)


def tips(tool: Tool) -> tuple[str, ...]:
    """Names of the sites at the tips, the upper part's first."""
    return tuple(f"{name}_tip" for name in BODIES[tool])
