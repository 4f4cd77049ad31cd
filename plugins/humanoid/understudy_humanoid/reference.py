"""A clip as the character's reference motion: tables of everything a task compares with."""

from __future__ import annotations

import math

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy import rotations
from understudy_characters.character import Character
from understudy_humanoid.kinematics import CharacterLayout, ground_clearance, kinematics
from understudy_motion.clip import Clip, CycleTransform, align_signs, cycle_transform

#: Table rows per control step. Between rows everything is interpolated linearly.
OVERSAMPLING = 4
#: How far ahead, in s, joint targets look: a damped servo lags its target by kd / kp, 0.1 s for all
#: joints of the humanoid, so targets that look ahead by as much put the joints on the reference.
TARGET_LEAD = 0.1
#: Half the time difference of the finite-difference velocities, in s.
_EPSILON = 1.0 / 120.0


def finite_difference_qvel(
    model: mujoco.MjModel, before: Tensor, after: Tensor, dt: float
) -> Tensor:
    """The constant ``qvel`` (F, nv) that takes ``qpos`` `before` to `after` (F, nq) in `dt` s."""
    result = np.zeros((len(before), model.nv))
    for row, first, second in zip(result, before.numpy(), after.numpy(), strict=True):
        mujoco.mj_differentiatePos(model, row, dt, first, second)
    return torch.from_numpy(result)


class ReferenceMotion:
    """The character's reference at any time, from one table, on one device.

    The root is lowered or raised by a constant so that the character's lowest point over the clip
    is on the floor (`ground`). Time runs on forever in a looping clip, whose root displacement and turn
    accumulate cycle by cycle; another clip holds its last pose.
    """

    def __init__(
        self,
        clip: Clip,
        model: mujoco.MjModel,
        layout: CharacterLayout,
        *,
        control_dt: float,
        device: torch.device | None = None,
        ground: bool = True,
        target_lead: float = TARGET_LEAD,
    ) -> None:
        device = device or torch.device("cpu")
        self.clip, self.duration, self.loop = clip, clip.duration, clip.loop
        self.control_dt = control_dt
        rows = max(2, math.ceil(clip.duration / control_dt * OVERSAMPLING) + 1)
        times = torch.linspace(0.0, clip.duration, rows, dtype=torch.float64)
        fields = self._tabulate(model, layout, times, ground, target_lead)
        self._shapes = {name: tuple(value.shape[1:]) for name, value in fields.items()}
        self._table = torch.cat([v.flatten(1) for v in fields.values()], dim=1).float().to(device)
        self._rows, self._rate = rows, (rows - 1) / clip.duration
        self._balls = layout.ball_joints.to(device), layout.ball_qpos.flatten().to(device)
        still = CycleTransform(torch.zeros(2, dtype=torch.float64), 0.0)
        self._cycle = cycle_transform(clip) if clip.loop else still

    def _tabulate(
        self,
        model: mujoco.MjModel,
        layout: CharacterLayout,
        times: Tensor,
        ground: bool,
        lead: float,
    ) -> dict[str, Tensor]:
        character = Character("humanoid", model)

        def qpos_at(at: Tensor) -> Tensor:
            return character.qpos(self.clip, at)

        qpos = qpos_at(times)
        for start in (3, *layout.ball_qpos[:, 0].tolist()):  # the root's quaternion, and the balls'
            qpos[:, start : start + 4] = align_signs(qpos[:, start : start + 4])
        edge = 0.0 if self.loop else _EPSILON
        centre = times.clamp(edge, self.duration - edge)
        qvel = finite_difference_qvel(
            model, qpos_at(centre - _EPSILON), qpos_at(centre + _EPSILON), 2 * _EPSILON
        )
        state = _forward(model, qpos, qvel)
        self.height_offset = 0.0
        if ground:
            clearance = ground_clearance(layout, state["xpos"], state["xquat"])
            self.height_offset = -float(clearance.min())
            qpos[:, 2] += self.height_offset
            state = _forward(model, qpos, qvel)
        derived = kinematics(layout, **state)
        targets = _joint_targets(model, layout, qpos_at(times + lead))
        return {
            "reference_qpos": qpos,
            "reference_qvel": qvel,
            "reference_com_position": derived["com_position"],
            "reference_joint_rotations": derived["joint_rotations"],
            "reference_end_effector_positions": derived["end_effector_positions"],
            "reference_joint_targets": targets,
        }

    def sample(self, time: Tensor) -> dict[str, Tensor]:
        """Reference fields at `time` (N,) s, float32: world-frame fields are where the motion has
        got to by then, ``phase`` is in [0, 1)."""
        if self.loop:
            cycles = torch.floor(time / self.duration)
            local = time - cycles * self.duration
        else:
            cycles, local = torch.zeros_like(time), time.clamp(0.0, self.duration)
        place = local * self._rate
        row = place.long().clamp(0, self._rows - 2)
        rows = torch.lerp(self._table[row], self._table[row + 1], (place - row).unsqueeze(1))
        fields = {
            name: part.view(-1, *shape)
            for (name, shape), part in zip(
                self._shapes.items(),
                rows.split([math.prod(s) for s in self._shapes.values()], dim=1),
                strict=True,
            )
        }
        joints = rotations.normalize(fields["reference_joint_rotations"])
        fields["reference_joint_rotations"] = joints
        qpos, qvel = fields["reference_qpos"], fields["reference_qvel"]
        rows_of_balls, addresses = self._balls
        qpos[:, addresses] = joints[:, rows_of_balls].flatten(1)  # normalised with the joints
        moved = self._carry(qpos, qvel, fields["reference_com_position"], cycles)
        root = moved["reference_qpos"]
        return {
            **fields,
            **moved,
            "reference_root_position": root[:, :3],
            "reference_root_rotation": root[:, 3:7],
            "reference_root_heading": rotations.heading(root[:, 3:7]),
            "phase": (local / self.duration).clamp(0.0, 1.0 - 1e-6),
        }

    def _carry(self, qpos: Tensor, qvel: Tensor, com: Tensor, cycles: Tensor) -> dict[str, Tensor]:
        """Move root, its velocity, and the centre of mass by `cycles` (N,) cycles."""
        displacement, angle = self._cycle.power(cycles)
        turn = rotations.from_heading(angle)
        shift = torch.nn.functional.pad(displacement, (0, 1))
        vectors = torch.stack([qpos[:, :3], com, qvel[:, :3]], dim=1)
        position, com, linear = rotations.rotate(turn.unsqueeze(1), vectors).unbind(1)
        rotation = rotations.normalize(rotations.multiply(turn, qpos[:, 3:7]))
        return {
            "reference_qpos": torch.cat([position + shift, rotation, qpos[:, 7:]], dim=1),
            "reference_qvel": torch.cat([linear, qvel[:, 3:]], dim=1),
            "reference_com_position": com + shift,
        }

    def to_first_cycle(
        self, qpos: Tensor, qvel: Tensor, time: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The states (N, nq), (N, nv) at `time` (N,), moved back into the first cycle."""
        cycles = torch.floor(time / self.duration) if self.loop else torch.zeros_like(time)
        displacement, angle = self._cycle.power(cycles)
        back = rotations.from_heading(-angle)
        shift = torch.nn.functional.pad(displacement, (0, 1))
        position = rotations.rotate(back, qpos[:, :3] - shift)
        rotation = rotations.multiply(back, qpos[:, 3:7])
        linear = rotations.rotate(back, qvel[:, :3])
        return (
            torch.cat([position, rotation, qpos[:, 7:]], dim=1),
            torch.cat([linear, qvel[:, 3:]], dim=1),
            time - cycles * self.duration,
        )


def _forward(model: mujoco.MjModel, qpos: Tensor, qvel: Tensor) -> dict[str, Tensor]:
    """MuJoCo's kinematics of each row: the arguments of :func:`kinematics`, float64."""
    data = mujoco.MjData(model)
    found: dict[str, list[np.ndarray]] = {k: [] for k in ("xpos", "xquat", "cvel", "subtree_com")}
    for position, velocity in zip(qpos.numpy(), qvel.numpy(), strict=True):
        data.qpos[:], data.qvel[:] = position, velocity
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_comVel(model, data)
        for name, values in found.items():
            values.append(getattr(data, name).copy())
    arrays = {name: torch.from_numpy(np.stack(values)) for name, values in found.items()}
    return {"qpos": qpos, **arrays}


def _joint_targets(model: mujoco.MjModel, layout: CharacterLayout, qpos: Tensor) -> Tensor:
    """(F, U): the actuators' lengths at `qpos`: exponential maps and angles.

    They follow the pose continuously but where a ball joint passes a half turn, as MuJoCo's do.
    """
    parts = []
    for name in layout.joint_names:
        joint = model.joint(name)
        address = int(joint.qposadr[0])
        if joint.type[0] == mujoco.mjtJoint.mjJNT_BALL:
            parts.append(rotations.to_exponential_map(qpos[:, address : address + 4]))
        else:
            parts.append(qpos[:, address : address + 1])
    return torch.cat(parts, dim=1)
