"""What tasks may read of a MuJoCo model: names, shapes, and how much must be computed for each."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import IntEnum

import mujoco
import numpy as np

from understudy.task import Shape

__all__ = ["AT_ITERATIONS", "AT_LIMIT", "RECENT", "Stage", "limits", "often", "readable"]

#: What the names of fields that are one sub-step old begin with.
RECENT = "recent_"
#: Names in ``report()``: steps of one world, or of one actuator.
AT_ITERATIONS, AT_LIMIT = "worlds_at_the_iteration_limit", "actuators_at_their_limit"
#: The share of its steps from which on such a limit is worth a word; below, motions meet it in passing.
_OFTEN = 0.05


def often(iterations: int, limits: int, steps: int, actuators: int) -> dict[str, int]:
    """What ``report()`` says of limits: how often worlds met that of the solver's iterations, and actuators
    that of their force, where it was in more than :data:`_OFTEN` of the `steps` of all worlds."""
    counts = {AT_ITERATIONS: (iterations, steps), AT_LIMIT: (limits, steps * actuators)}
    return {name: count for name, (count, of) in counts.items() if count > _OFTEN * of}


class Stage(IntEnum):
    """How far the forward computation must have gone for a field to be right."""

    KINEMATICS = 1  #: the state, and poses and velocities of bodies
    VELOCITY = 2  #: contacts, actuator lengths, sensors of positions and velocities
    ACCELERATION = 3  #: the whole of ``mj_forward``: forces, accelerations and their sensors


@dataclass(frozen=True)
class Field:
    """A field of ``MjData``, or some columns of ``sensordata``."""

    array: str
    stage: Stage
    shape: Shape
    columns: slice
    recent: bool = False  #: as the last sub-step had it, before it moved the state


#: MjData's arrays that tasks may read. Names and frames are MuJoCo's.
ARRAYS = {
    "qpos": Stage.KINEMATICS,
    "qvel": Stage.KINEMATICS,
    "ctrl": Stage.KINEMATICS,
    "xpos": Stage.KINEMATICS,
    "xquat": Stage.KINEMATICS,
    "xmat": Stage.KINEMATICS,
    "xipos": Stage.KINEMATICS,
    "cvel": Stage.KINEMATICS,
    "subtree_com": Stage.KINEMATICS,
    "geom_xpos": Stage.KINEMATICS,
    "geom_xmat": Stage.KINEMATICS,
    "site_xpos": Stage.KINEMATICS,
    "site_xmat": Stage.KINEMATICS,
    "actuator_length": Stage.VELOCITY,
    "actuator_velocity": Stage.VELOCITY,
    "actuator_force": Stage.ACCELERATION,
    "qacc": Stage.ACCELERATION,
    "qfrc_actuator": Stage.ACCELERATION,
    "qfrc_constraint": Stage.ACCELERATION,
}
#: MuJoCo computes these (``mj_rnePostConstraint``) only for models with a sensor that needs them.
BODY_FORCES = ("cacc", "cfrc_int", "cfrc_ext")
_NEED_BODY_FORCES = {
    int(mujoco.mjtSensor.mjSENS_ACCELEROMETER),
    int(mujoco.mjtSensor.mjSENS_FORCE),
    int(mujoco.mjtSensor.mjSENS_TORQUE),
    int(mujoco.mjtSensor.mjSENS_FRAMELINACC),
    int(mujoco.mjtSensor.mjSENS_FRAMEANGACC),
}
_STAGES = {
    int(mujoco.mjtStage.mjSTAGE_ACC): Stage.ACCELERATION,
    int(mujoco.mjtStage.mjSTAGE_VEL): Stage.VELOCITY,
    int(mujoco.mjtStage.mjSTAGE_POS): Stage.VELOCITY,
    int(mujoco.mjtStage.mjSTAGE_NONE): Stage.VELOCITY,
}


def readable(model: mujoco.MjModel) -> dict[str, Field]:
    """Everything that can be read of `model`: :data:`ARRAYS`, ``sensordata``, and every named sensor
    as ``sensor_NAME`` (dim,).

    What needs forces is there a second time, as ``recent_FIELD``: as the last sub-step computed it on its
    way, which is one sub-step old and costs no forward computation; 0 where an episode begins.
    """
    data = mujoco.MjData(model)
    stages = dict(ARRAYS)
    if _NEED_BODY_FORCES & set(model.sensor_type.tolist()):
        stages.update(dict.fromkeys(BODY_FORCES, Stage.ACCELERATION))
    found = {
        name: Field(name, stage, tuple(getattr(data, name).shape), slice(None))
        for name, stage in stages.items()
    }
    sensors = [_STAGES[int(stage)] for stage in model.sensor_needstage]
    found["sensordata"] = Field(
        "sensordata", max(sensors, default=Stage.KINEMATICS), (model.nsensordata,), slice(None)
    )
    for index, stage in enumerate(sensors):
        name = model.sensor(index).name
        if name:
            start, size = int(model.sensor_adr[index]), int(model.sensor_dim[index])
            columns = slice(start, start + size)
            found[f"sensor_{name}"] = Field("sensordata", stage, (size,), columns)
    recent = {
        f"{RECENT}{name}": replace(field, stage=Stage.KINEMATICS, recent=True)
        for name, field in found.items()
        if field.stage == Stage.ACCELERATION and field.array not in BODY_FORCES
    }
    return found | recent


def limits(model: mujoco.MjModel) -> np.ndarray:
    """(nu,) N or N m: the most force of each actuator; infinite where it has no limit."""
    low, high = model.actuator_forcerange.T
    most = np.maximum(np.abs(low), np.abs(high))
    return np.where(model.actuator_forcelimited, most, np.inf)
