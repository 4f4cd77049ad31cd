"""The jumper of the plugin ``humanoid``, and what section 4.7.2 makes of it."""

from __future__ import annotations

import mujoco

from understudy_humanoid.jumper import build_jumper

#: The leg that takes off, and what is left of its torques (figure 4.11).
TAKE_OFF, WEAK = ("right_hip", "right_knee", "right_ankle"), 0.6


def build_weak_leg() -> mujoco.MjSpec:
    """The jumper, whose take-off hip, knee and ankle have 60 % of their torque."""
    spec = build_jumper()
    for actuator in spec.actuators:
        if actuator.target in TAKE_OFF:
            actuator.forcerange = [WEAK * float(limit) for limit in actuator.forcerange]
    return spec
