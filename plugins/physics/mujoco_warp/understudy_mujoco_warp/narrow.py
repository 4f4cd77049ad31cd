"""Ranges of joints and tendons that are too narrow for MuJoCo Warp."""

from __future__ import annotations

import mujoco
import numpy as np

from understudy.errors import ConfigError

#: Joints with a limit at either end; a ball's has one.
_TWO_LIMITS = (mujoco.mjtJoint.mjJNT_HINGE, mujoco.mjtJoint.mjJNT_SLIDE)


def refuse_narrow_ranges(model: mujoco.MjModel) -> None:
    """Check that the two limits of each joint and tendon never act at once.

    A limit acts within its margin. Where both do, MuJoCo has a constraint for each, and they balance;
    MuJoCo Warp 4.0.0 has one for the nearer alone, which throws the joint to and fro.

    Raises
    ------
    ConfigError
        naming the first joint, or else tendon, of which both act somewhere in its range.
    """
    joints = (model.jnt_limited != 0) & np.isin(model.jnt_type, _TWO_LIMITS)
    for kind, limited, span, margin in (
        ("joint", joints, model.jnt_range, model.jnt_margin),
        ("tendon", model.tendon_limited != 0, model.tendon_range, model.tendon_margin),
    ):
        width = span[:, 1] - span[:, 0]
        narrow = np.flatnonzero(limited & (2.0 * margin > width * (1.0 + 1e-6)))
        if narrow.size:
            first = int(narrow[0])
            name = (model.joint if kind == "joint" else model.tendon)(first).name or first
            raise ConfigError(
                f"simulator 'mujoco_warp' cannot run this scene: {kind} '{name}' has a range of "
                f"{width[first]:g} and a margin of {margin[first]:g}, so both its limits act at once, "
                f"and MuJoCo Warp computes only the nearer. Give it a margin of at most "
                f"{0.5 * width[first]:g}, or use simulator=mujoco."
            )
