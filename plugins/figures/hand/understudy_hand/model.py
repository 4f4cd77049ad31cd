"""The MuJoCo model of arm, hand and tool, built from the table."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import combinations

import mujoco
import numpy as np

from understudy_hand import tools
from understudy_hand.table import ARM, DENSITY, Link, Shape, can_meet

__all__ = ["TABLE_CENTRE", "TABLE_SIZE"]

#: Bits of contact masks.
_HAND, _TOOL, _TABLE = 1, 2, 4
#: Of the arm and of the hand: gain N m/rad, damping N m s/rad, and N m at most (the release).
ARM_SERVO, HAND_SERVO = (5000.0, 500.0, 1000.0), (1.0, 0.1, 10.0)
_ARM_ARMATURE, _WRIST_ARMATURE, _HAND_ARMATURE = 1.0, 0.005, 0.001
#: m: how far around a tip a contact counts as one of it.
_AROUND = 0.002
#: kg m², of links without a shape (the release).
_SMALL = 1e-5
_FRICTION_LOSS, _HAND_DAMPING = 0.001, 0.05
#: rad: how far before a limit it acts (the release), but at most this share of a hinge's range: some
#: ranges are so narrow that both limits would act at once.
_MARGIN, _SHARE = 0.01, 0.25
_SKIN, _SLEEVE, _TOP = (0.87, 0.67, 0.53, 1.0), (0.36, 0.44, 0.56, 1.0), (0.75, 0.77, 0.80, 1.0)
#: m: the table's half sizes and middle; its top is at z = 0 (the release).
TABLE_SIZE, TABLE_CENTRE = (0.5, 0.315, 0.2), (-0.24, 0.0, -0.2)


def build_spec(
    links: Sequence[Link],
    fingers: Sequence[str],
    tool: tools.Tool,
    friction: float = 1.0,
    thing: tools.Thing | None = None,
    below: tools.Thing | None = None,
    above: tools.Thing | None = None,
    self_collision: bool = False,
) -> mujoco.MjSpec:
    """Arm and hand of these `links` and `fingers`, tool and table, with a `thing` on it, one `below` and one `above`, or without. Arm and hand bear their own weight, the others do
    not.

    Every hinge of arm and hand has a position servo of its name, in the order of the joints. Hand links
    touch tools and the table, and one another only with `self_collision`, and then those of different fingers that
    :func:`~understudy_hand.table.can_meet`.
    """
    spec = mujoco.MjSpec()
    spec.compiler.degree = False
    spec.worldbody.add_geom(
        name="table", type=mujoco.mjtGeom.mjGEOM_BOX, size=TABLE_SIZE, pos=TABLE_CENTRE,
        contype=_TABLE, conaffinity=_HAND | _TOOL, friction=[friction, 0.005, 0.0001], rgba=_TOP,
    )  # fmt: skip
    half = float(np.sqrt(0.5))
    base = spec.worldbody.add_body(name="base", pos=[0, -0.45, 0.2], quat=[half, -half, 0, 0])
    bodies, arm = {"base": base}, {link.name for link in ARM}
    for link in links:
        body = bodies[link.parent].add_body(name=link.name, pos=link.offset, quat=link.turn)
        body.gravcomp = 1.0
        bodies[link.name] = body
        _add_hinges(spec, body, link, link.name in arm)
        if link.shape is not None:
            _add_shape(body, link, link.shape, friction, link.name in arm)
        elif link.mass:
            body.explicitinertial, body.mass = True, link.mass
            body.ipos, body.inertia = np.zeros(3), np.full(3, _SMALL)
    if self_collision:
        _let_meet(spec, [n.name for n in links if n.shape is not None and n.name not in arm])
    tools.add(spec, tool, friction, (_TOOL, _HAND | _TOOL))
    for name, lying in (("object", thing), ("below", below), ("above", above)):
        if lying is not None:
            tools.add_thing(spec, name, lying, friction, (_TOOL, _HAND | _TOOL))
    for name in (*(f"{finger}_distal" for finger in fingers), *tools.tips(tool)):
        _add_touch(spec, name)
    return spec


def _let_meet(spec: mujoco.MjSpec, names: Sequence[str]) -> None:
    """Let the links `names` of different fingers touch one another."""
    for name in names:
        spec.geom(name).conaffinity = _HAND
    for one, other in combinations(names, 2):
        if not can_meet(one, other):
            spec.add_exclude(bodyname1=one, bodyname2=other)


def _add_touch(spec: mujoco.MjSpec, name: str) -> None:
    """The sensor ``touch_NAME`` N: the normal forces on a finger's tip, or at a tool's."""
    sensor = spec.add_sensor(
        name=f"touch_{name}", type=mujoco.mjtSensor.mjSENS_TOUCH, objtype=mujoco.mjtObj.mjOBJ_SITE
    )
    sensor.objname = f"touch_{name}"


def _add_hinges(spec: mujoco.MjSpec, body: mujoco.MjsBody, link: Link, arm: bool) -> None:
    gain, damping, most = ARM_SERVO if arm else HAND_SERVO
    armature = _HAND_ARMATURE
    if arm:
        armature = _WRIST_ARMATURE if link.name == "wrist" else _ARM_ARMATURE
    for hinge in link.hinges:
        body.add_joint(
            name=hinge.name, axis=hinge.axis, pos=hinge.anchor, range=hinge.range, limited=True,
            armature=armature, frictionloss=_FRICTION_LOSS,
            margin=min(_MARGIN, _SHARE * (hinge.range[1] - hinge.range[0])),
            damping=np.array([0.0 if arm else _HAND_DAMPING, 0.0, 0.0]),
        )  # fmt: skip
        servo = spec.add_actuator(
            name=hinge.name, target=hinge.name, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        servo.set_to_position(kp=gain, kv=damping)
        servo.forcerange, servo.forcelimited = [-most, most], True


def _add_shape(body: mujoco.MjsBody, link: Link, shape: Shape, friction: float, arm: bool) -> None:
    tip = link.name.endswith("_distal")
    geom = body.add_geom(
        name=link.name, pos=shape.centre, contype=0 if arm else _HAND, conaffinity=0,
        condim=4 if tip else 3, friction=[friction, 0.005, 0.001],
        rgba=_SLEEVE if arm else _SKIN, density=DENSITY,
    )  # fmt: skip
    if shape.box is not None:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_BOX, shape.box
    elif shape.half_length > 0:
        geom.type = mujoco.mjtGeom.mjGEOM_CAPSULE
        geom.size = [shape.radius, shape.half_length, 0]
    else:
        geom.type, geom.size = mujoco.mjtGeom.mjGEOM_SPHERE, [shape.radius, 0, 0]
    if tip:
        body.add_site(
            name=f"touch_{link.name}", type=mujoco.mjtGeom.mjGEOM_CAPSULE, pos=shape.centre,
            size=[shape.radius + _AROUND, shape.half_length, 0], group=4,
        )  # fmt: skip
    half = float(np.sqrt(0.5))
    turn = shape.tilt / 2
    geom.quat = [half, -half, 0, 0] if shape.along_y else [np.cos(turn), 0, np.sin(turn), 0]
    if shape.turn is not None:
        geom.quat = shape.turn
    if link.mass is not None:
        geom.mass = link.mass
