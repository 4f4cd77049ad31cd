"""The jumper of the plugin ``humanoid``, and what section 4.7.2 makes of it."""

from __future__ import annotations

import math
from collections.abc import Mapping

import mujoco

from understudy_humanoid.jumper import build_jumper

#: The leg that takes off, and what is left of its torques (figure 4.11).
TAKE_OFF, WEAK = ("right_hip", "right_knee", "right_ankle"), 0.6
#: rad: targets of the servo that bends the spine forwards, none backwards (figure 4.12).
STIFF = {"chest_y": (0.0, math.pi)}
#: rad: targets of the swing leg's knee as it is at the take-off (figure 4.13); a range has a width.
FIXED = {"left_knee": (1.599, 1.601)}


def build_weak_leg() -> mujoco.MjSpec:
    """The jumper, whose take-off hip, knee and ankle have 60 % of their torque."""
    spec = build_jumper()
    for actuator in spec.actuators:
        if actuator.target in TAKE_OFF:
            actuator.forcerange = [WEAK * float(limit) for limit in actuator.forcerange]
    return spec


def build_stiff_spine() -> mujoco.MjSpec:
    """The jumper, whose spine is not arched backwards, whatever acts."""
    return _limited(STIFF)


def build_fixed_knee() -> mujoco.MjSpec:
    """The jumper, whose swing leg's knee is held, whatever acts."""
    return _limited(FIXED)


def _limited(ranges: Mapping[str, tuple[float, float]]) -> mujoco.MjSpec:
    """The jumper, the controls of whose servos `ranges` limits, rad."""
    spec = build_jumper()
    for name, limits in ranges.items():
        servo = spec.actuator(name)
        servo.ctrllimited, servo.ctrlrange = True, limits
    return spec
