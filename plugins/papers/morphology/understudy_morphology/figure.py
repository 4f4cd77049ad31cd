"""The walker: a table of links that follows from twelve scales, and the MuJoCo model built from it.

A torso, a waist, a pelvis and two legs of thigh, knee (the shank) and foot, as in table 6.1 of the
thesis; 15 hinges, each with a motor. The thesis gives ranges of the scales and no more. Joints, their
ranges, torques and damping are those of the biped of Yu, Turk and Liu 2018, from which the task is
taken; sizes are a person's.

Frames: z up, x forward, y left; all links' frames are parallel in the zero pose, which stands with
straight legs. Lengths in m, masses in kg, angles in rad, torques in N m.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, fields

import mujoco

from understudy.options import check_range
from understudy_characters.staging import add_floor, solve_fast

Vector = tuple[float, float, float]

#: Table 6.1.
LENGTH_RANGE, RADIUS_RANGE = (0.3, 2.0), (0.5, 1.5)

#: Between a link's joints (a capsule's length without its caps, the box of a foot from heel to toe).
LENGTHS = {"torso": 0.25, "waist": 0.1, "pelvis": 0.16, "thigh": 0.42, "knee": 0.42, "foot": 0.24}
#: Of the capsules; of a foot half its width.
RADII = {"torso": 0.12, "waist": 0.09, "pelvis": 0.09, "thigh": 0.06, "knee": 0.045, "foot": 0.045}
DENSITY = 1000.0  #: kg/m³, of every link
#: Of a foot: its height over its width, and the share of its length that is behind the ankle.
FLATNESS, HEEL = 0.55, 0.3

ROOT, TORSO, FEET = "pelvis", "torso", ("left_foot", "right_foot")
DAMPING, ARMATURE = 5.0, 0.01  #: N m s/rad, kg m²; of every joint
TIMESTEP = 0.0165 / 4  #: s; 500 control periods of four of these are the 8.25 s of section 6.4.1

DAMPED = 1.0  #: s, kd / kp: "kd is set to be equal to kp" (section 6.4.1)
#: What helps the root, in the order of the controls: the direction (0 to 2 along x, y, z of the world, 3 to 5
#: about them), and what the gain is multiplied by: a constant, the place, its rate.
HELP = {
    "push_x": (0, (1.0, 0.0, 0.0)),
    "damp_x": (0, (0.0, 0.0, -DAMPED)),
    "hold_y": (1, (0.0, -1.0, -DAMPED)),
    "hold_roll": (3, (0.0, -1.0, -DAMPED)),
    "hold_pitch": (4, (0.0, -1.0, -DAMPED)),
    "hold_yaw": (5, (0.0, -1.0, -DAMPED)),
}

COLOUR, FOOT_COLOUR = (0.36, 0.56, 0.78, 1.0), (0.93, 0.6, 0.32, 1.0)


@dataclass(frozen=True)
class Scales:
    """Of each link's length and radius, left and right alike (table 6.1)."""

    torso_length: float = 1.0  #: factor, above 0, of the torso's length
    waist_length: float = 1.0  #: factor, above 0, of the waist's length
    pelvis_length: float = 1.0  #: factor, above 0, of the pelvis' length
    thigh_length: float = 1.0  #: factor, above 0, of the thighs' length
    knee_length: float = 1.0  #: factor, above 0, of the knees' length
    foot_length: float = 1.0  #: factor, above 0, of the feet's length
    torso_radius: float = 1.0  #: factor, above 0, of the torso's radius
    waist_radius: float = 1.0  #: factor, above 0, of the waist's radius
    pelvis_radius: float = 1.0  #: factor, above 0, of the pelvis' radius
    thigh_radius: float = 1.0  #: factor, above 0, of the thighs' radius
    knee_radius: float = 1.0  #: factor, above 0, of the knees' radius
    foot_radius: float = 1.0  #: factor, above 0, of the feet's radius

    def __post_init__(self) -> None:
        for item in fields(self):
            low, high = LENGTH_RANGE if item.name.endswith("length") else RADIUS_RANGE
            check_range(self, item.name, least=low, most=high)

    def length(self, link: str) -> float:
        """m"""
        return LENGTHS[link] * getattr(self, f"{link}_length")

    def radius(self, link: str) -> float:
        """m"""
        return RADII[link] * getattr(self, f"{link}_radius")


@dataclass(frozen=True)
class Hinge:
    """A hinge about `axis`, with a motor of at most `torque`."""

    name: str
    axis: Vector
    range: tuple[float, float]
    torque: float


@dataclass(frozen=True)
class Link:
    """A link: where its joints sit in the parent's frame, and its shape in its own."""

    name: str
    parent: str | None
    offset: Vector
    shape: tuple[Vector, Vector, float] | tuple[Vector, Vector]
    """A capsule's ends and radius, or a box's centre and half sizes."""
    hinges: tuple[Hinge, ...] = ()


def links(scales: Scales) -> tuple[Link, ...]:
    """The walker of these `scales`, parents before children; the root's offset is where it stands.

    The trunk is stacked cap on cap, the hips are at the ends of the pelvis, and the foot lies under
    the shank's cap, so no scale moves a link into the floor.
    """
    length, radius = scales.length, scales.radius
    pelvis, waist, torso = radius("pelvis"), length("waist"), radius("torso")
    half = 0.5 * length("pelvis")
    standing: Vector = (0.0, 0.0, standing_height(scales))
    bend = (
        Hinge("waist_x", (1, 0, 0), (-0.6, 0.6), 200.0),
        Hinge("waist_y", (0, 1, 0), (-0.1, 0.8), 200.0),
        Hinge("waist_z", (0, 0, 1), (-0.3, 0.3), 200.0),
    )
    shoulders: Vector = (0, 0, torso + length("torso"))
    return (
        Link("pelvis", None, standing, ((0, -half, 0), (0, half, 0), pelvis)),
        Link("waist", "pelvis", (0, 0, pelvis), ((0, 0, 0), (0, 0, waist), radius("waist")), bend[:1]),
        Link("torso", "waist", (0, 0, waist), ((0, 0, torso), shoulders, torso), bend[1:]),
        *_leg("left", 1, half, scales),
        *_leg("right", -1, -half, scales),
    )  # fmt: skip


def _leg(side: str, outward: int, y: float, scales: Scales) -> Iterator[Link]:
    """`outward` is 1 on the left, so that positive angles of both legs are mirror images."""
    thigh, shank, foot = (scales.length(link) for link in ("thigh", "knee", "foot"))
    shin, width = scales.radius("knee"), scales.radius("foot")
    hip = (
        Hinge(f"{side}_hip_y", (0, -1, 0), (-0.5, 1.8), 250.0),
        Hinge(f"{side}_hip_z", (0, 0, outward), (-0.3, 0.6), 60.0),
        Hinge(f"{side}_hip_x", (outward, 0, 0), (0.0, 0.8), 80.0),
    )
    knee = (Hinge(f"{side}_knee", (0, 1, 0), (0.0, 2.6), 100.0),)
    ankle = (
        Hinge(f"{side}_ankle_y", (0, -1, 0), (-0.785, 0.785), 60.0),
        Hinge(f"{side}_ankle_x", (outward, 0, 0), (-0.55, 0.55), 60.0),
    )
    down: Vector = (0, 0, -thigh)
    yield Link(f"{side}_thigh", ROOT, (0, y, 0), ((0, 0, 0), down, scales.radius("thigh")), hip)
    yield Link(f"{side}_knee", f"{side}_thigh", down, ((0, 0, 0), (0, 0, -shank), shin), knee)
    centre: Vector = ((0.5 - HEEL) * foot, 0, -shin - FLATNESS * width)
    box: Vector = (0.5 * foot, width, FLATNESS * width)
    yield Link(f"{side}_foot", f"{side}_knee", (0, 0, -shank), (centre, box), ankle)


def standing_height(scales: Scales) -> float:
    """m, of the root above the soles in the zero pose."""
    legs = scales.length("thigh") + scales.length("knee") + scales.radius("knee")
    return legs + 2 * FLATNESS * scales.radius("foot")


def build_spec(scales: Scales, timestep: float = TIMESTEP) -> mujoco.MjSpec:
    """The walker on a floor, to be stepped by `timestep` s.

    Controls are first the shares of the hinges' torques, in [-1, 1], in the order of :func:`links`, then
    those of :data:`HELP`. Links touch the floor and not one another.
    """
    spec = mujoco.MjSpec()
    spec.modelname = "walker"
    spec.compiler.degree = False
    spec.option.timestep = timestep
    solve_fast(spec.option)
    add_floor(spec)
    made: dict[str, mujoco.MjsBody] = {}
    for link in links(scales):
        parent = spec.worldbody if link.parent is None else made[link.parent]
        body = made[link.name] = parent.add_body(name=link.name, pos=link.offset)
        geom = body.add_geom(name=link.name, density=DENSITY, rgba=COLOUR)
        geom.contype, geom.conaffinity, geom.condim = 2, 1, 3
        if len(link.shape) == 3:
            start, end, radius = link.shape
            geom.type, geom.fromto = mujoco.mjtGeom.mjGEOM_CAPSULE, [*start, *end]
            geom.size = [radius, 0, 0]
        else:
            geom.type, geom.rgba = mujoco.mjtGeom.mjGEOM_BOX, FOOT_COLOUR
            geom.pos, geom.size = link.shape
        if link.parent is None:
            body.add_freejoint(name=ROOT)
        for hinge in link.hinges:
            body.add_joint(
                name=hinge.name,
                type=mujoco.mjtJoint.mjJNT_HINGE,
                axis=hinge.axis,
                limited=True,
                range=hinge.range,
                damping=DAMPING,
                armature=ARMATURE,
            )
            _motor(spec, hinge)
    _add_help(spec, made[ROOT])
    return spec


def _motor(spec: mujoco.MjSpec, hinge: Hinge) -> None:
    motor = spec.add_actuator(name=hinge.name, target=hinge.name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    motor.gear = [hinge.torque, 0, 0, 0, 0, 0]
    motor.ctrllimited, motor.ctrlrange = True, [-1, 1]


def _add_help(spec: mujoco.MjSpec, root: mujoco.MjsBody) -> None:
    """Controllers of the root's pose in the world, whose control c is their gain.

    Those that hold give c (-x - kd/kp v) for the place x (m), or the rotation (rad), and its rate v at
    the end of the physics step: x is taken one step h ahead, as x + h v, and the engine integrates the
    velocity's part implicitly. That is stable PD (Tan, Liu and Turk 2011) with the whole walker's inertia.
    """
    root.add_site(name="held")
    spec.worldbody.add_site(name="hand")
    for name, (axis, (constant, place, rate)) in HELP.items():
        helper = spec.add_actuator(
            name=name, target="held", refsite="hand", trntype=mujoco.mjtTrn.mjTRN_SITE
        )
        helper.gear = [float(i == axis) for i in range(6)]
        helper.gaintype, helper.biastype = mujoco.mjtGain.mjGAIN_AFFINE, mujoco.mjtBias.mjBIAS_NONE
        helper.gainprm = [constant, place, rate + place * spec.option.timestep, *[0.0] * 7]
