"""Take-off states: the features that are explored, and whole states that have them.

The take-off is midway through the last support phase before the athlete is airborne (thesis, section
4.3). Features are those of sections 4.6.1 and 4.7, in the frames and with the signs of tables 4.3 and
4.4: x forward, y up, z to the right of where the athlete faces. All the rest of the state stays what
the pose is (section 4.8), but for the velocities of the leg that stands: its foot rests.
"""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import mujoco
import numpy as np
import torch

from understudy.errors import ConfigError
from understudy.options import check_range
from understudy_characters.character import Character
from understudy_tensors import rotations
from understudy_tensors.limits import check_angle

_FASTEST = 20.0
"""m/s, beyond any runner."""
_TURNING = 50.0
"""rad/s, some three times what divers and skaters reach."""


@dataclass(frozen=True)
class Takeoff:
    """Features of a take-off state; the defaults are the Fosbury flop's of table 4.3."""

    #: m/s, velocity of the root to the right; the run bends to the right, and drifts left
    v_z: float = -2.4
    omega_x: float = -3.0  #: rad/s, angular velocity of the root about forward
    #: rad/s, angular velocity about up; of high jumps always so, turning right as the run does
    omega_y: float = -3.0
    omega_z: float = 1.0  #: rad/s, angular velocity about right
    alpha: float = -0.05  #: rad, angle of approach: 0 has the obstacle on its left, π/2 in front
    forward: float = 4.5  #: m/s, velocity of the root forward; searches do not vary it

    def __post_init__(self) -> None:
        check_range(self, "forward", least=0, most=_FASTEST)
        check_range(self, "v_z", least=-_FASTEST, most=_FASTEST)
        check_range(self, "omega_x", "omega_y", "omega_z", least=-_TURNING, most=_TURNING)
        check_angle(self, "alpha")

    @property
    def features(self) -> tuple[float, ...]:
        return self.v_z, self.omega_x, self.omega_y, self.omega_z, self.alpha

    @property
    def heading(self) -> float:
        """rad: where it faces in the world, whose x axis points across the obstacle."""
        return self.alpha - 0.5 * math.pi

    @property
    def linear(self) -> tuple[float, float, float]:
        """m/s, of the root along forward, left and up."""
        return self.forward, -self.v_z, 0.0

    @property
    def angular(self) -> tuple[float, float, float]:
        """rad/s, of the root about forward, left and up."""
        return self.omega_x, -self.omega_z, self.omega_y


@dataclass(frozen=True)
class Pose:
    """Joints at the take-off, of the athlete's right side and left side as it is named.

    Angles (rad) and rates (rad/s) by joint: exponential maps about forward, left and up of balls,
    numbers of hinges. The root leans by the rotation vector `lean`.
    """

    lean: tuple[float, float, float]
    angles: Mapping[str, tuple[float, ...]]
    rates: Mapping[str, tuple[float, ...]]


#: Planting the right foot at the end of a run that bends to the right: body leaning back and into the
#: bend, right knee bent, left leg and both arms swinging forward. Ours, after pictures of high jumps.
PLANT = Pose(
    lean=(0.2, -0.12, 0.0),
    angles={
        "chest": (0.1, 0.0, -0.1), "neck": (0.0, 0.3, 0.1),
        "right_hip": (0.1, -0.7, 0.0), "right_knee": (0.8,),
        "left_hip": (0.05, 0.2, 0.3), "left_knee": (1.6,), "left_ankle": (-0.1, 0.5, 0.2),
        "right_shoulder": (-0.2, 0.2, -0.1), "right_elbow": (1.3,),
        "left_shoulder": (0.3, -0.5, -0.3), "left_elbow": (1.6,),
    },
    rates={
        "left_hip": (1.5, -9.0, 0.0), "left_knee": (9.0,),
        "right_shoulder": (-2.0, -7.0, 0.0), "left_shoulder": (2.0, -5.0, 0.0),
    },
)  # fmt: skip

#: The same at the end of a straight run: upright, thighs and arms swinging through.
STEP = Pose(
    lean=(0.0, 0.05, 0.0),
    angles={
        "chest": (0.0, 0.1, 0.0), "neck": (0.0, 0.2, 0.0),
        "right_hip": (0.0, -0.85, 0.0), "right_knee": (0.8,),
        "left_hip": (0.0, -0.3, 0.0), "left_knee": (1.8,),
        "right_shoulder": (-0.3, 0.4, 0.0), "right_elbow": (1.0,),
        "left_shoulder": (0.3, -0.3, 0.0), "left_elbow": (1.2,),
    },
    rates={
        "left_hip": (0.0, -9.0, 0.0), "left_knee": (2.0,),
        "right_shoulder": (0.0, -7.0, 0.0), "left_shoulder": (0.0, 3.0, 0.0),
    },
)  # fmt: skip

POSES: Mapping[str, Pose] = {"plant": PLANT, "step": STEP}
#: The one that stands in these poses.
FOOT = "right_ankle"


def takeoff_states(
    character: Character, pose: Pose, takeoffs: Sequence[Takeoff]
) -> tuple[np.ndarray, np.ndarray]:
    """``qpos`` (K, nq) and ``qvel`` (K, nv) of the take-offs, the root over x = y = 0, the sole of
    the right foot at rest flat on the ground.

    Raises
    ------
    ConfigError
        if the character lacks one of the pose's joints.
    """
    rows = [_state(character, pose, takeoff) for takeoff in takeoffs]
    qpos, qvel = zip(*rows, strict=True)
    return np.array(qpos), np.array(qvel)


def _state(character: Character, pose: Pose, takeoff: Takeoff) -> tuple[np.ndarray, np.ndarray]:
    model, data = character.model, mujoco.MjData(character.model)
    at = character.root_address
    qpos, qvel = model.qpos0.copy(), np.zeros(model.nv)
    for name, angles in pose.angles.items():
        joint = _joint(model, character, name)
        start = int(model.jnt_qposadr[joint])
        if len(angles) == 1:
            qpos[start] = angles[0]
        else:
            qpos[start : start + 4] = _quaternion(angles)
    turn = rotations.from_heading(torch.tensor(takeoff.heading, dtype=torch.float64))
    root = rotations.multiply(turn, torch.from_numpy(_quaternion(pose.lean)))
    qpos[at : at + 3], qpos[at + 3 : at + 7] = (0.0, 0.0, 1.0), root.numpy()

    body, ankle = model.body(FOOT).id, _joint(model, character, FOOT)
    data.qpos[:] = qpos
    mujoco.mj_kinematics(model, data)
    shank = torch.from_numpy(data.xquat[model.body_parentid[body]].copy())
    start = int(model.jnt_qposadr[ankle])
    qpos[start : start + 4] = rotations.multiply(rotations.conjugate(shank), turn).numpy()
    clearance = character.clearance(torch.from_numpy(qpos)[None])
    qpos[at + 2] -= float(clearance.min())

    dof = int(model.body_dofadr[character.root])
    level = torch.stack(
        [torch.tensor(v, dtype=torch.float64) for v in (takeoff.linear, takeoff.angular)]
    )
    linear, angular = rotations.rotate(turn, level)
    qvel[dof : dof + 3] = linear.numpy()
    qvel[dof + 3 : dof + 6] = rotations.inverse_rotate(root, angular).numpy()
    for name, rates in pose.rates.items():
        first = int(model.jnt_dofadr[_joint(model, character, name)])
        qvel[first : first + len(rates)] = rates
    return qpos, _resting(model, data, qpos, qvel, body)


def _resting(
    model: mujoco.MjModel, data: mujoco.MjData, qpos: np.ndarray, qvel: np.ndarray, foot: int
) -> np.ndarray:
    """`qvel`, with the least velocities of the joints between the root and the body `foot` with which
    that body neither moves nor turns."""
    data.qpos[:], data.qvel[:] = qpos, qvel
    mujoco.mj_kinematics(model, data)
    mujoco.mj_comPos(model, data)
    jacobian = np.zeros((6, model.nv))
    mujoco.mj_jacBody(model, data, jacobian[:3], jacobian[3:], foot)
    leg, body = np.zeros(model.nv, dtype=bool), foot
    while model.body_parentid[body] and model.jnt_type[model.body_jntadr[body]] != 0:
        first = int(model.body_dofadr[body])
        leg[first : first + int(model.body_dofnum[body])] = True
        body = int(model.body_parentid[body])
    rest = np.where(leg, 0.0, qvel)
    rest[leg] = np.linalg.lstsq(jacobian[:, leg], -jacobian @ rest, rcond=None)[0]
    return rest


def _joint(model: mujoco.MjModel, character: Character, name: str) -> int:
    if name not in character.joint_names:
        raise ConfigError(
            f"A take-off needs the joint '{name}', which the character {character.name} has not got. "
            "Choose an athlete of the humanoid's joints (scene.character=jumper)."
        )
    return int(model.body_jntadr[model.body(name).id])


def _quaternion(vector: Sequence[float]) -> np.ndarray:
    return rotations.from_exponential_map(torch.tensor(vector, dtype=torch.float64)).numpy()
