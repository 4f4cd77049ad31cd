"""The 21-DoF humanoid as a table of links and hinges.

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

import mujoco

from understudy_characters.table import Joint, Link, Vector, add_joining, build_figure
from understudy_humanoid.character import joining

#: Height of the root above the soles in the zero pose.
STANDING_HEIGHT = 0.882
COLOUR = (0.36, 0.55, 0.78, 1.0)
TIMESTEP = 1 / 240

_FORWARD, _LEFT, _UP = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def _hinge(name: str, axis: Vector, range: tuple[float, float], torque: float, kp: float) -> Joint:
    """A hinge whose servo has the gains kp and kp / 10."""
    return Joint("hinge", torque, kp, 0.1 * kp, axis, range, name)


def _bar(
    name: str,
    parent: str | None,
    offset: Vector,
    radius: float,
    start: Vector,
    end: Vector,
    mass: float,
    hinges: tuple[Joint, ...] = (),
) -> Link:
    """A link that is a capsule from `start` to `end`."""
    centre = (0.0, 0.0, 0.0)
    return Link(name, parent, offset, "capsule", (radius,), centre, mass, hinges, (start, end))


def _leg(side: str, y: float) -> Iterator[Link]:
    out = 1.0 if side == "left" else -1.0  # abduction and toeing out have the side's sign
    spread = (-0.5, 0.9) if out > 0 else (-0.9, 0.5)
    turn = (-0.7, 0.9) if out > 0 else (-0.9, 0.7)
    hip = (
        _hinge(f"{side}_hip_x", _FORWARD, spread, 200, 500),
        _hinge(f"{side}_hip_z", _UP, turn, 200, 500),
        _hinge(f"{side}_hip_y", _LEFT, (-2.2, 0.9), 200, 500),
    )
    knee = (_hinge(f"{side}_knee", _LEFT, (0.0, 2.7), 150, 500),)
    ankle = (
        _hinge(f"{side}_ankle_y", _LEFT, (-0.9, 1.1), 90, 400),
        _hinge(f"{side}_ankle_x", _FORWARD, (-0.6, 0.6), 90, 400),
    )
    thigh, shin = (0, 0, -0.06), (0, 0, -0.36)
    yield _bar(f"{side}_hip", "root", (0, y, 0), 0.055, thigh, shin, 4.5, hip)
    calf = (0, 0, -0.045), (0, 0, -0.355)
    yield _bar(f"{side}_knee", f"{side}_hip", (0, 0, -0.422), 0.05, *calf, 3.0, knee)
    sole, centre = (0.0885, 0.045, 0.0275), (0.045, 0, -0.0225)
    yield Link(f"{side}_ankle", f"{side}_knee", (0, 0, -0.41), "box", sole, centre, 1.0, ankle)


def _arm(side: str, y: float) -> Iterator[Link]:
    out = 1.0 if side == "left" else -1.0
    lift = (-0.5, 2.6) if out > 0 else (-2.6, 0.5)
    shoulder = (
        _hinge(f"{side}_shoulder_y", _LEFT, (-3.0, 1.2), 100, 400),
        _hinge(f"{side}_shoulder_x", _FORWARD, lift, 100, 400),
    )
    elbow = (_hinge(f"{side}_elbow", (0.0, -1.0, 0.0), (0.0, 2.6), 60, 300),)
    upper, place = ((0, 0, -0.05), (0, 0, -0.23)), (-0.024, y, 0.2435)
    yield _bar(f"{side}_shoulder", "chest", place, 0.045, *upper, 1.5, shoulder)
    lower, place = ((0, 0, -0.0525), (0, 0, -0.259)), (0, 0, -0.275)
    yield _bar(f"{side}_elbow", f"{side}_shoulder", place, 0.04, *lower, 1.5, elbow)


_WAIST = (
    _hinge("waist_z", _UP, (-0.8, 0.8), 200, 1000),
    _hinge("waist_y", _LEFT, (-0.6, 1.4), 200, 1000),
    _hinge("waist_x", _FORWARD, (-0.6, 0.6), 200, 1000),
)

#: The character, parents before children.
BODIES: tuple[Link, ...] = (
    _bar("root", None, (0, 0, 0), 0.092, (0, -0.06, 0.017), (0, 0.06, 0.017), 6.0),
    Link("chest", "root", (0, 0, 0.236), "sphere", (0.11,), (0, 0, 0.12), 14.0, _WAIST),
    Link("neck", "chest", (0, 0, 0.224), "sphere", (0.1025,), (0, 0, 0.175), 2.0),
    *_leg("right", -0.085),
    *_arm("right", -0.183),
    *_leg("left", 0.085),
    *_arm("left", 0.183),
)


def build_humanoid() -> mujoco.MjSpec:
    """The humanoid on a floor, each hinge driven by a position servo."""
    spec = build_figure(
        BODIES, name="humanoid21", standing_height=STANDING_HEIGHT, timestep=TIMESTEP, colour=COLOUR
    )
    add_joining(spec, joining(elbow=(-0.1, 0.041), hip=(-0.12, 0.056)), COLOUR)
    return spec
