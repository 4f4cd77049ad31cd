"""The jumper: the humanoid's figure at 60 kg, with legs strong enough for athletic jumps.

The character of "Discovering Diverse Athletic Jumping Strategies" (Yin et al., SIGGRAPH 2021; thesis,
chapter 4), whose hips and ankles are far weaker about their own length than in flexion. Masses and
gains are the humanoid's, increased alike, so that joints respond as fast.
"""

from __future__ import annotations

from dataclasses import replace

import mujoco

from understudy_characters.table import Joint, Link, Vector
from understudy_humanoid.character import BODIES, add_trunk, build_spec

__all__ = ["build_jumper"]

MASS = 60.0
_INCREASE = MASS / sum(row.mass for row in BODIES)

#: N m, about the axes forward, left and up of the zero pose for ball joints.
TORQUES: dict[str, float | Vector] = {
    "chest": 200.0,
    "neck": 50.0,
    "hip": (500.0, 500.0, 50.0),
    "knee": 400.0,
    "ankle": (100.0, 300.0, 50.0),
    "shoulder": (100.0, 100.0, 50.0),
    "elbow": 50.0,
}


def _stronger(row: Link) -> Link:
    def driven(joint: Joint) -> Joint:
        torque = TORQUES[row.name.rpartition("_")[2]]
        return replace(joint, torque=torque, kp=joint.kp * _INCREASE, kd=joint.kd * _INCREASE)

    return replace(row, mass=row.mass * _INCREASE, joints=tuple(map(driven, row.joints)))


#: The character, parents before children.
JUMPER: tuple[Link, ...] = tuple(_stronger(row) for row in BODIES)


def build_jumper() -> mujoco.MjSpec:
    """The jumper on a floor, as it is seen."""
    spec = build_spec(bodies=JUMPER, name="jumper")
    add_trunk(spec)
    return spec
