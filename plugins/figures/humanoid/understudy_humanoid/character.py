"""The humanoid: one table of bodies, and the MuJoCo model built from it.

34 degrees of freedom (a free root, 8 ball joints, 4 hinges), 15 links, 45 kg (thesis, section 3.5).
Frames: z up, x forward, y left; all body frames are parallel in the zero pose, which stands with
the arms hanging. Lengths in m, masses in kg, angles in rad, torques in N m.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Literal

import mujoco

from understudy_characters.servos import add_servo
from understudy_characters.staging import add_floor, add_sky, add_sun, solve_fast
from understudy_mujoco.studio import LEARNED

Vector = tuple[float, float, float]


@dataclass(frozen=True)
class Joint:
    """A joint and its actuator: stable PD with gains `kp`, `kd`, limited to `torque`."""

    kind: Literal["ball", "hinge"]
    torque: float | Vector  #: of a ball joint one for all axes, or one about each
    kp: float
    kd: float
    axis: Vector = (0.0, 1.0, 0.0)
    range: tuple[float, float] | None = None


@dataclass(frozen=True)
class Body:
    """A link: where its joint sits in the parent's frame, and its geometry in its own."""

    name: str
    parent: str | None
    offset: Vector
    shape: Literal["sphere", "capsule", "box"]
    #: Sphere: (radius,); capsule: (radius, half length), along z; box: half sizes along x, y, z.
    size: tuple[float, ...]
    centre: Vector
    mass: float
    joint: Joint | None = None


_KNEE = Joint("hinge", 150, 500, 50, axis=(0, 1, 0), range=(0.0, 3.0))
_ELBOW = Joint("hinge", 60, 300, 30, axis=(0, -1, 0), range=(0.0, 3.0))


def _leg(side: str, y: float) -> Iterator[Body]:
    hip, ankle = Joint("ball", 200, 500, 50), Joint("ball", 90, 400, 40)
    yield Body(f"{side}_hip", "root", (0, y, 0), "capsule", (0.055, 0.15), (0, 0, -0.21), 4.5, hip)
    yield Body(
        f"{side}_knee",
        f"{side}_hip",
        (0, 0, -0.422),
        "capsule",
        (0.05, 0.155),
        (0, 0, -0.2),
        3.0,
        _KNEE,
    )
    yield Body(
        f"{side}_ankle",
        f"{side}_knee",
        (0, 0, -0.41),
        "box",
        (0.0885, 0.045, 0.0275),
        (0.045, 0, -0.0225),
        1.0,
        ankle,
    )


def _arm(side: str, y: float) -> Iterator[Body]:
    shoulder = Joint("ball", 100, 400, 40)
    yield Body(
        f"{side}_shoulder",
        "chest",
        (-0.024, y, 0.2435),
        "capsule",
        (0.045, 0.09),
        (0, 0, -0.14),
        1.5,
        shoulder,
    )
    yield Body(
        f"{side}_elbow",
        f"{side}_shoulder",
        (0, 0, -0.275),
        "capsule",
        (0.04, 0.0675),
        (0, 0, -0.12),
        1.0,
        _ELBOW,
    )
    yield Body(f"{side}_wrist", f"{side}_elbow", (0, 0, -0.259), "sphere", (0.04,), (0, 0, 0), 0.5)


#: The character, parents before children. Proportions and gains follow the humanoid that the
#: DeepMimic clips were made for, so that those clips fit without retargeting.
BODIES: tuple[Body, ...] = (
    Body("root", None, (0, 0, 0), "sphere", (0.09,), (0, 0, 0.07), 6.0),
    Body(
        "chest",
        "root",
        (0, 0, 0.236),
        "sphere",
        (0.11,),
        (0, 0, 0.12),
        14.0,
        Joint("ball", 200, 1000, 100),
    ),
    Body(
        "neck",
        "chest",
        (0, 0, 0.224),
        "sphere",
        (0.1025,),
        (0, 0, 0.175),
        2.0,
        Joint("ball", 50, 100, 10),
    ),
    *_leg("right", -0.085),
    *_arm("right", -0.183),
    *_leg("left", 0.085),
    *_arm("left", 0.183),
)

#: Height of the root above the soles in the zero pose: thigh, shin, and the foot's depth.
STANDING_HEIGHT = 0.422 + 0.41 + 0.05

COLOUR = LEARNED

#: What joins the links in pictures: body, capsule's ends in its frame, radius.
_TRUNK: tuple[tuple[str, Vector, Vector, float], ...] = (
    ("root", (0, -0.06, 0.03), (0, 0.06, 0.03), 0.075),
    ("root", (0, 0, 0.08), (0, 0, 0.21), 0.078),
    ("chest", (0, 0, 0.02), (0, 0, 0.13), 0.09),
    ("chest", (-0.015, -0.125, 0.215), (-0.015, 0.125, 0.215), 0.052),
    ("neck", (0, 0, -0.02), (0, 0, 0.1), 0.045),
    *(
        (f"{side}_{name}", (0, 0, 0), (0, 0, end), radius)
        for side in ("right", "left")
        for name, end, radius in (
            ("shoulder", -0.1, 0.047),
            ("elbow", -0.24, 0.036),
            ("hip", -0.12, 0.06),
            ("knee", -0.06, 0.051),
            ("ankle", -0.01, 0.04),
        )
    ),
)

_SHAPES = {
    "sphere": mujoco.mjtGeom.mjGEOM_SPHERE,
    "capsule": mujoco.mjtGeom.mjGEOM_CAPSULE,
    "box": mujoco.mjtGeom.mjGEOM_BOX,
}


def build_spec(
    *,
    timestep: float = 1 / 600,
    self_collision: bool = False,
    bodies: Sequence[Body] = BODIES,
    name: str = "humanoid",
) -> mujoco.MjSpec:
    """The humanoid on a floor, or another character of these `bodies` and standing height, as a model
    specification to be compiled or added to.

    Actuators are position servos (stable PD, :mod:`understudy_characters.servos`) on exponential maps
    (ball) and angles (hinge), three or one a joint in table order.
    """
    spec = mujoco.MjSpec()
    spec.modelname = name
    spec.compiler.degree = False
    spec.option.timestep = timestep
    solve_fast(spec.option)
    add_sky(spec)
    add_floor(spec)
    _add_character(spec, self_collision, bodies)
    add_sun(spec, "root")
    return spec


def build_humanoid() -> mujoco.MjSpec:
    """The humanoid as it is seen."""
    spec = build_spec()
    add_trunk(spec)
    return spec


def _add_character(spec: mujoco.MjSpec, self_collision: bool, bodies: Sequence[Body]) -> None:
    """Add the character's bodies and actuators."""
    made: dict[str, mujoco.MjsBody] = {}
    for row in bodies:
        parent = spec.worldbody if row.parent is None else made[row.parent]
        offset = row.offset if row.parent is not None else (0, 0, STANDING_HEIGHT)
        body = made[row.name] = parent.add_body(name=row.name, pos=offset)
        geom = body.add_geom(
            name=row.name,
            type=_SHAPES[row.shape],
            size=[*row.size, 0, 0][:3],
            pos=row.centre,
            mass=row.mass,
            rgba=COLOUR,
        )
        # Bit 1: floor to character; bit 2: character to character.
        geom.contype = 2
        geom.conaffinity = 1 | (2 if self_collision else 0)
        geom.condim = 3
        geom.friction = [1.0, 0.005, 0.0001]
        if row.parent is None:
            body.add_freejoint(name=row.name)
        elif row.joint is not None:
            _add_joint(spec, body, row.name, row.joint)


def add_trunk(spec: mujoco.MjSpec) -> None:
    """Join the character's links by shapes without mass or contact, for pictures only."""
    for name, start, end, radius in _TRUNK:
        spec.body(name).add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE,
            fromto=[*start, *end],
            size=[radius, 0, 0],
            mass=0,
            contype=0,
            conaffinity=0,
            rgba=COLOUR,
        )


def _add_joint(spec: mujoco.MjSpec, body: mujoco.MjsBody, name: str, row: Joint) -> None:
    ball = row.kind == "ball"
    joint = body.add_joint(
        name=name,
        type=mujoco.mjtJoint.mjJNT_BALL if ball else mujoco.mjtJoint.mjJNT_HINGE,
        armature=0.01,  # rotor inertia; keeps light limbs' accelerations bounded
    )
    if not ball:
        joint.axis = row.axis
        if row.range is not None:
            joint.limited, joint.range = True, row.range
    damping = row.kd + row.kp * spec.option.timestep
    torques = row.torque if isinstance(row.torque, tuple) else (row.torque,) * 3
    for axis in range(3) if ball else (None,):
        add_servo(spec, name, axis, torques[axis or 0], row.kp, damping)
