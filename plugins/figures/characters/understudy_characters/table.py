"""A figure as a table of links, and the MuJoCo model built from it.

Frames: z up, x forward, y left; all links' frames are parallel in the zero pose. Lengths in m, masses in
kg, angles in rad, torques in N m.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco

from understudy.errors import ConfigError
from understudy_characters.servos import add_servo
from understudy_characters.staging import add_floor, add_sky, add_sun, solve_fast

__all__ = ["Joint", "Link", "Vector", "add_joining", "build_figure"]

Vector = tuple[float, float, float]
Colour = tuple[float, float, float, float]

#: kg m^2, of the rotors; keeps light limbs' accelerations bounded.
_ARMATURE = 0.01
_SHAPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}


@dataclass(frozen=True)
class Joint:
    """A joint and its servo: stable PD with gains `kp`, `kd`, limited to `torque`."""

    kind: Literal["ball", "hinge"]
    torque: float | Vector  #: of a ball joint one for all axes, or one about each
    kp: float
    kd: float
    axis: Vector = (0.0, 1.0, 0.0)
    range: tuple[float, float] | None = None
    name: str | None = None  #: None: its link's


@dataclass(frozen=True)
class Link:
    """A link: where its joints sit in the parent's frame, and its shape in its own."""

    name: str
    parent: str | None
    offset: Vector
    shape: Literal["sphere", "capsule", "box"]
    #: Sphere: (radius,); capsule: (radius, half length), along z; box: half sizes along x, y, z.
    size: tuple[float, ...]
    centre: Vector
    mass: float
    joints: tuple[Joint, ...] = ()
    #: Of a capsule, in place of half length and centre.
    ends: tuple[Vector, Vector] | None = None


def build_figure(
    links: Sequence[Link],
    *,
    name: str,
    standing_height: float,
    timestep: float,
    colour: Colour,
    self_collision: bool = False,
) -> mujoco.MjSpec:
    """The figure of these `links`, parents before children, on a floor.

    Parameters
    ----------
    name
        of the model
    standing_height
        m, of the first link, which floats freely, above the floor in the zero pose
    timestep
        s
    colour
        of all links, as red, green, blue and opacity
    self_collision
        whether links collide with one another

    Returns
    -------
    mujoco.MjSpec
        to be compiled or added to. Actuators are position servos (stable PD,
        :mod:`understudy_characters.servos`) on exponential maps (ball) and angles (hinge), three or one a
        joint in the order of the table.

    Raises
    ------
    ConfigError
        there are no links, two have one name or no parent, or one hangs on none before it.
    """
    if not links:
        raise ConfigError(f"The figure '{name}' has no links.")
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.option.timestep = timestep
    solve_fast(spec.option)
    add_sky(spec)
    add_floor(spec)
    made: dict[str, mujoco.MjsBody] = {}
    for link in links:
        if link.name in made:
            raise ConfigError(f"The figure '{name}' has two links '{link.name}'.")
        if link.parent is not None and link.parent not in made:
            raise ConfigError(
                f"The figure '{name}' has no link '{link.parent}' before '{link.name}', which hangs on it."
            )
        if link.parent is None and made:
            raise ConfigError(
                f"The figure '{name}' has two links without a parent: '{link.name}' is one."
            )
        parent = spec.worldbody if link.parent is None else made[link.parent]
        place = link.offset if link.parent is not None else (0, 0, standing_height)
        body = made[link.name] = parent.add_body(name=link.name, pos=place)
        _add_shape(body, link, colour, self_collision)
        if link.parent is None:
            body.add_freejoint(name=link.name)
        for joint in link.joints:
            _add_joint(spec, body, joint)
    add_sun(spec, links[0].name)
    return spec


def add_joining(
    spec: mujoco.MjSpec, joining: Iterable[tuple[str, Vector, Vector, float]], colour: Colour
) -> None:
    """Join a figure's links for pictures only, by capsules without mass or contact: each the link, its ends
    in the link's frame, its radius."""
    for name, start, end, radius in joining:
        spec.body(name).add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*start, *end],
            size=[radius, 0, 0],
            mass=0,
            contype=0,
            conaffinity=0,
            rgba=colour,
        )


def _add_shape(body: mujoco.MjsBody, link: Link, colour: Colour, self_collision: bool) -> None:
    geom = body.add_geom(
        name=link.name, type=_SHAPES[link.shape], size=[*link.size, 0, 0][:3], pos=link.centre,
        mass=link.mass, rgba=colour,
    )  # fmt: skip
    if link.ends is not None:
        start, end = link.ends
        geom.fromto = [*start, *end]
    # Bit 1: floor to figure; bit 2: figure to figure.
    geom.contype = 2
    geom.conaffinity = 1 | (2 if self_collision else 0)
    geom.condim = 3
    geom.friction = [1.0, 0.005, 0.0001]


def _add_joint(spec: mujoco.MjSpec, body: mujoco.MjsBody, row: Joint) -> None:
    name, ball = row.name or body.name, row.kind == "ball"
    joint = body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_BALL if ball else mujoco.mjtJoint.mjJNT_HINGE,
        armature=_ARMATURE,
    )
    if not ball:
        joint.axis = row.axis
        if row.range is not None:
            joint.limited, joint.range = True, row.range
    damping = row.kd + row.kp * spec.option.timestep  # stable PD looks one time step ahead
    torques = row.torque if isinstance(row.torque, tuple) else (row.torque,) * 3
    for axis in range(3) if ball else (None,):
        add_servo(spec, name, axis, torques[axis or 0], row.kp, damping)
