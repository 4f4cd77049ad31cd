"""The 21-DoF humanoid: one table of bodies and hinges, and the MuJoCo model built from it.

"We use a humanoid model with 21 degrees of freedom" (section 4), Bullet's, whose joints are waist (3),
hips (3 each), knees (1), ankles (2), shoulders (2) and elbows (1). These are its joints on the
proportions, masses, gains and torque limits of the DeepMimic humanoid
(:mod:`understudy_humanoid.character`), so that clips made for that one fit this one: bodies have the
same names, and the head is fixed to the chest. 45 kg. The pelvis is a bar across, a
little lower than the thighs in sitting, so that it is the pelvis that touches a seat.

Frames: z up, x forward, y left, all parallel in the zero pose, which stands with the arms hanging.
Lengths in m, masses in kg, angles in rad, torques in N m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import mujoco

from understudy_characters.servos import add_servo
from understudy_characters.staging import add_floor, add_sky, add_sun, solve_fast

Vector = tuple[float, float, float]

#: Height of the root above the soles in the zero pose.
STANDING_HEIGHT = 0.882
COLOUR = (0.36, 0.55, 0.78, 1.0)
TIMESTEP = 1 / 240
#: kg m^2, of the rotors; keeps the accelerations of light limbs bounded.
_ARMATURE = 0.01

_FORWARD, _LEFT, _UP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


@dataclass(frozen=True)
class Hinge:
    """A hinge and its servo: stable PD with gains `kp` and kp / 10, limited to `torque`."""

    name: str
    axis: Vector
    range: tuple[float, float]
    torque: float
    kp: float


@dataclass(frozen=True)
class Body:
    """A link: where its hinges sit in the parent's frame, and its shape in its own."""

    name: str
    parent: str | None
    offset: Vector
    shape: str  #: sphere, capsule (from `start` to `end`) or box (around `start`, half sizes `end`)
    radius: float
    start: Vector
    end: Vector
    mass: float
    hinges: tuple[Hinge, ...] = ()


def _leg(side: str, y: float) -> Iterator[Body]:
    out = 1.0 if side == "left" else -1.0  # abduction and toeing out have the side's sign
    spread = (-0.5, 0.9) if out > 0 else (-0.9, 0.5)
    turn = (-0.7, 0.9) if out > 0 else (-0.9, 0.7)
    hip = (
        Hinge(f"{side}_hip_x", _FORWARD, spread, 200, 500),
        Hinge(f"{side}_hip_z", _UP, turn, 200, 500),
        Hinge(f"{side}_hip_y", _LEFT, (-2.2, 0.9), 200, 500),
    )
    knee = (Hinge(f"{side}_knee", _LEFT, (0.0, 2.7), 150, 500),)
    ankle = (
        Hinge(f"{side}_ankle_y", _LEFT, (-0.9, 1.1), 90, 400),
        Hinge(f"{side}_ankle_x", _FORWARD, (-0.6, 0.6), 90, 400),
    )
    thigh, shin = (0, 0, -0.06), (0, 0, -0.36)
    yield Body(f"{side}_hip", "root", (0, y, 0), "capsule", 0.055, thigh, shin, 4.5, hip)
    calf = (0, 0, -0.045), (0, 0, -0.355)
    yield Body(f"{side}_knee", f"{side}_hip", (0, 0, -0.422), "capsule", 0.05, *calf, 3.0, knee)
    sole = (0.045, 0, -0.0225), (0.0885, 0.045, 0.0275)
    yield Body(f"{side}_ankle", f"{side}_knee", (0, 0, -0.41), "box", 0.0, *sole, 1.0, ankle)


def _arm(side: str, y: float) -> Iterator[Body]:
    out = 1.0 if side == "left" else -1.0
    lift = (-0.5, 2.6) if out > 0 else (-2.6, 0.5)
    shoulder = (
        Hinge(f"{side}_shoulder_y", _LEFT, (-3.0, 1.2), 100, 400),
        Hinge(f"{side}_shoulder_x", _FORWARD, lift, 100, 400),
    )
    elbow = (Hinge(f"{side}_elbow", (0.0, -1.0, 0.0), (0.0, 2.6), 60, 300),)
    upper, place = ((0, 0, -0.05), (0, 0, -0.23)), (-0.024, y, 0.2435)
    yield Body(f"{side}_shoulder", "chest", place, "capsule", 0.045, *upper, 1.5, shoulder)
    lower, place = ((0, 0, -0.0525), (0, 0, -0.259)), (0, 0, -0.275)
    yield Body(f"{side}_elbow", f"{side}_shoulder", place, "capsule", 0.04, *lower, 1.5, elbow)


_WAIST = (
    Hinge("waist_z", _UP, (-0.8, 0.8), 200, 1000),
    Hinge("waist_y", _LEFT, (-0.6, 1.4), 200, 1000),
    Hinge("waist_x", _FORWARD, (-0.6, 0.6), 200, 1000),
)

#: The character, parents before children.
BODIES: tuple[Body, ...] = (
    Body("root", None, (0, 0, 0), "capsule", 0.092, (0, -0.06, 0.017), (0, 0.06, 0.017), 6.0),
    Body("chest", "root", (0, 0, 0.236), "sphere", 0.11, (0, 0, 0.12), (0, 0, 0), 14.0, _WAIST),
    Body("neck", "chest", (0, 0, 0.224), "sphere", 0.1025, (0, 0, 0.175), (0, 0, 0), 2.0),
    *_leg("right", -0.085),
    *_arm("right", -0.183),
    *_leg("left", 0.085),
    *_arm("left", 0.183),
)

#: What joins the links in pictures: body, a capsule's ends in its frame, radius.
_JOINING: tuple[tuple[str, Vector, Vector, float], ...] = (
    ("root", (0, 0, 0.08), (0, 0, 0.21), 0.078),
    ("chest", (0, 0, 0.02), (0, 0, 0.13), 0.09),
    ("chest", (-0.015, -0.125, 0.215), (-0.015, 0.125, 0.215), 0.052),
    ("neck", (0, 0, -0.02), (0, 0, 0.1), 0.045),
    *(
        (f"{side}_{name}", (0, 0, 0), (0, 0, end), radius)
        for side in ("right", "left")
        for name, end, radius in (
            ("shoulder", -0.1, 0.047),
            ("elbow", -0.1, 0.041),
            ("hip", -0.12, 0.056),
            ("knee", -0.06, 0.051),
            ("ankle", -0.01, 0.04),
        )
    ),
)


def build_humanoid() -> mujoco.MjSpec:
    """The humanoid on a floor, each hinge driven by a position servo."""
    spec = mujoco.MjSpec()
    spec.modelname = "humanoid21"
    spec.compiler.degree = False
    spec.option.timestep = TIMESTEP
    solve_fast(spec.option)
    add_sky(spec)
    add_floor(spec)
    made: dict[str, mujoco.MjsBody] = {}
    for row in BODIES:
        parent = spec.worldbody if row.parent is None else made[row.parent]
        offset = row.offset if row.parent is not None else (0, 0, STANDING_HEIGHT)
        body = made[row.name] = parent.add_body(name=row.name, pos=offset)
        _add_shape(body, row)
        if row.parent is None:
            body.add_freejoint(name=row.name)
        for hinge in row.hinges:
            _add_hinge(spec, body, hinge)
    for name, start, end, radius in _JOINING:
        made[name].add_geom(
            type=mujoco.mjtGeom.mjGEOM_CAPSULE, fromto=[*start, *end], size=[radius, 0, 0],
            mass=0, contype=0, conaffinity=0, rgba=COLOUR,
        )  # fmt: skip
    add_sun(spec, "root")
    return spec


def _add_shape(body: mujoco.MjsBody, row: Body) -> None:
    geom = body.add_geom(name=row.name, mass=row.mass, rgba=COLOUR)
    if row.shape == "capsule":
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_CAPSULE, [row.radius, 0, 0]
        geom.fromto = [*row.start, *row.end]
    elif row.shape == "sphere":
        geom.type, geom.size, geom.pos = mujoco.mjtGeom.mjGEOM_SPHERE, [row.radius, 0, 0], row.start
    else:
        geom.type, geom.size, geom.pos = mujoco.mjtGeom.mjGEOM_BOX, row.end, row.start
    geom.condim = 3
    geom.friction = [1.0, 0.005, 0.0001]


def _add_hinge(spec: mujoco.MjSpec, body: mujoco.MjsBody, hinge: Hinge) -> None:
    joint = body.add_joint(
        name=hinge.name, type=mujoco.mjtJoint.mjJNT_HINGE, axis=hinge.axis, armature=_ARMATURE
    )
    joint.limited, joint.range = True, hinge.range
    kd = 0.1 * hinge.kp + hinge.kp * TIMESTEP  # stable PD looks one time step ahead
    add_servo(spec, hinge.name, None, hinge.torque, hinge.kp, kd)
