"""A clip as a character's reference motion: tables of everything a task compares with."""

from __future__ import annotations

import hashlib
import math
from collections.abc import Mapping

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy.errors import FileError
from understudy_characters.character import Character
from understudy_characters.layout import Layout
from understudy_characters.servos import lags
from understudy_characters.state import poses_of
from understudy_motion.clip import Clip, CycleTransform, align_signs, cycle_transform
from understudy_motion.limits import MAX_ROTATIONS
from understudy_motion.section import Floor
from understudy_mujoco.scene import model_digest
from understudy_tensors import rotations

__all__ = ["ReferenceMotion"]

#: Table rows per control step. Between rows everything is interpolated linearly.
OVERSAMPLING = 4
#: Half the time difference of the finite-difference velocities, in s.
_EPSILON = 1.0 / 120.0
#: A clip closes where its poses so many s before its end and after it differ by less, in m and rad.
_INSTANT, _CLOSED = 1e-6, 1e-3
#: m/s², s: a centre of mass that falls faster, over twice this time, is in flight.
_FALLING, _HALF_SPAN = -0.5 * 9.81, 0.03
#: s: a motion has ended when so little of it is left.
_LAST = 1e-4
#: Tables by what they are computed of, and how far the root was raised: training, evaluation and each skill that one
#: controls ask for the same ones.
_tables: dict[bytes, tuple[dict[str, Tensor], float]] = {}
_MOST = 1 << 28  #: bytes of them that are kept


def difference_qvel(layout: Layout, nv: int, before: Tensor, after: Tensor, dt: float) -> Tensor:
    """The constant ``qvel`` (F, nv) that takes the figure's ``qpos`` from `before` to `after` (F, nq)
    in `dt` s, as ``mj_differentiatePos`` does; zero of anything else."""
    result = before.new_zeros(len(before), nv)
    at, dof = layout.root_address, layout.root_dof
    result[:, dof : dof + 3] = after[:, at : at + 3] - before[:, at : at + 3]
    # Quaternions' velocities are in their own frames. The root's row comes before those of the balls.
    quaternions = torch.cat([torch.arange(at + 3, at + 7)[None], layout.ball_qpos])
    dofs = torch.cat([torch.arange(dof + 3, dof + 6)[None], layout.ball_dofs])
    first, second = (
        pose[:, quaternions.flatten()].unflatten(1, (-1, 4)) for pose in (before, after)
    )
    turned = rotations.multiply(rotations.conjugate(first), second)
    result[:, dofs.flatten()] = rotations.to_exponential_map(turned).flatten(1)
    hinges = layout.hinge_used.bool()
    addresses, columns = layout.hinge_qpos[hinges], layout.hinge_dofs[hinges]
    result[:, columns] = after[:, addresses] - before[:, addresses]
    return result / dt


class ReferenceMotion:
    """The character's reference at any time, from one table, on one device.

    The root is lowered or raised by a constant so that the character's lowest point over the clip
    is on the floor, or (`floor="standing"`) the median of its lowest points while something carries it; some
    poses are then within the floor. Velocities are those of the poses; where the ends of a looping clip are not
    the same pose, they are those within a cycle, not of the jump to the next. Time runs on forever in a
    looping clip, whose root displacement and turn accumulate cycle by cycle; another clip ends, and what is
    asked for later is its last pose.
    Joint targets look ahead by as much as the character's servos lag, so that they put the joints on the
    reference.
    """

    def __init__(
        self,
        clip: Clip,
        character: Character,
        layout: Layout,
        *,
        control_dt: float,
        device: torch.device | None = None,
        floor: Floor = "lowest",
    ) -> None:
        device, clip = device or torch.device("cpu"), character.posed(clip)
        self.clip, self.duration, self.loop = clip, clip.duration, clip.loop
        self.control_dt, self._root = control_dt, layout.root_address
        self._root_dof = layout.root_dof
        rows = max(2, math.ceil(clip.duration / control_dt * OVERSAMPLING) + 1)
        if rows * len(character.joints) > MAX_ROTATIONS:
            most = MAX_ROTATIONS / len(character.joints) / OVERSAMPLING * control_dt
            raise FileError(
                f"Clip {clip.source or clip.name} lasts {clip.duration:.4g} s, and at control.frequency={1 / control_dt:g} this "
                f"figure follows at most {most:.0f}. Cut it."
            )
        times = torch.linspace(0.0, clip.duration, rows, dtype=torch.float64)
        fields = self._tables(character, layout, times, floor)
        self.sinks = float(fields["reference_link_clearances"].min()) < -1e-9  #: into the floor
        self._shapes = {name: tuple(value.shape[1:]) for name, value in fields.items()}
        self._table = torch.cat([v.flatten(1) for v in fields.values()], dim=1).float().to(device)
        self._rows, self._rate = rows, (rows - 1) / clip.duration
        self._pose = self._pose_columns(layout, fields).to(device)
        still = CycleTransform(torch.zeros(2, dtype=torch.float64), 0.0)
        self._cycle = cycle_transform(clip) if clip.loop else still
        self._stride = torch.tensor([*self._cycle.displacement.tolist(), 0.0], device=device)

    def _tables(
        self, character: Character, layout: Layout, times: Tensor, floor: Floor
    ) -> dict[str, Tensor]:
        """What :meth:`_tabulate` gives, computed once a process for the same content."""
        clip = self.clip
        of = (clip.times, clip.root_position, clip.rotations, times, *vars(layout).values())
        found = hashlib.sha256(model_digest(character.model))
        for part in (*of, clip.joint_names, clip.loop, floor):
            if isinstance(part, Tensor):
                found.update(part.numpy().tobytes())
                part = tuple(part.shape)
            found.update(repr(part).encode())
        key = found.digest()
        if key not in _tables:
            fields = self._tabulate(character, layout, times, floor)
            kept = sum(v.nbytes for known, _ in _tables.values() for v in known.values())
            if kept + sum(v.nbytes for v in fields.values()) > _MOST:
                _tables.clear()
            _tables[key] = fields, self.height_offset
        fields, self.height_offset = _tables[key]
        return fields

    def _tabulate(
        self, character: Character, layout: Layout, times: Tensor, floor: Floor
    ) -> dict[str, Tensor]:
        model, at = character.model, layout.root_address

        def qpos_at(when: Tensor) -> Tensor:
            return character.qpos(self.clip, when)

        qpos = qpos_at(times)
        for start in (at + 3, *layout.ball_qpos[:, 0].tolist()):
            qpos[:, start : start + 4] = align_signs(qpos[:, start : start + 4])

        def moved(when: Tensor, reach: float) -> Tensor:
            """The displacement of the figure from `reach` s before `when` to as long after it."""
            return difference_qvel(
                layout, model.nv, qpos_at(when - reach), qpos_at(when + reach), 1.0
            )

        closed = self.loop and float(moved(times[-1:], _INSTANT).abs().max()) < _CLOSED
        inside = times.clamp(_EPSILON, self.duration - _EPSILON)
        qvel = moved(times if closed else inside, _EPSILON) / (2 * _EPSILON)
        poses = poses_of(character, layout)
        self.height_offset = -_floor(poses.state(qpos), times, floor)
        qpos[:, at + 2] += self.height_offset
        state = poses.state(qpos)
        targets = torch.zeros(len(times), model.nu, dtype=torch.float64)
        ahead = np.round(lags(model), 3)
        for lag in np.unique(ahead):
            columns = np.flatnonzero(ahead == lag)
            targets[:, columns] = _lengths(model, layout, qpos_at(times + lag))[:, columns]
        return {
            "reference_qpos": qpos,
            "reference_qvel": qvel,
            "reference_com_position": state["com_position"],
            "reference_joint_rotations": state["joint_rotations"],
            "reference_end_effector_positions": state["end_effector_positions"],
            "reference_link_clearances": state["link_clearances"],
            "reference_joint_targets": targets,
        }

    def sample(self, time: Tensor) -> dict[str, Tensor]:
        """Reference fields at `time` (N,) s, float32: world-frame fields are where the motion has
        got to by then, ``phase`` is in [0, 1), ``motion_ended`` (bool) where nothing is left of it."""
        if self.loop:
            cycles = torch.floor(time / self.duration)
            local = time - cycles * self.duration
            ended = torch.zeros_like(time, dtype=torch.bool)
        else:
            cycles, local = torch.zeros_like(time), time.clamp(0.0, self.duration)
            ended = time >= self.duration - _LAST
        place = local * self._rate
        row = place.long().clamp(0, self._rows - 2)
        before, after = (self._table.index_select(0, at) for at in (row, row + 1))
        rows = torch.lerp(before, after, (place - row).unsqueeze(1))
        fields = {
            name: part.view(len(rows), *shape)
            for (name, shape), part in zip(
                self._shapes.items(),
                rows.split([math.prod(s) for s in self._shapes.values()], dim=1),
                strict=True,
            )
        }
        joints = fields["reference_joint_rotations"]
        joints /= torch.linalg.vector_norm(joints, dim=-1, keepdim=True)
        qpos, qvel = rows.index_select(1, self._pose), fields["reference_qvel"]
        moved = self._carry(qpos, qvel, fields["reference_com_position"], cycles)
        at = self._root
        root = moved["reference_qpos"][:, at : at + 7]
        return {
            **fields,
            **moved,
            "reference_root_position": root[:, :3],
            "reference_root_rotation": root[:, 3:],
            "reference_root_heading": rotations.heading(root[:, 3:]),
            "phase": (local / self.duration).clamp(0.0, 1.0 - 1e-6),
            "motion_ended": ended,
        }

    def raised(self, qpos: Tensor, height: Tensor) -> Tensor:
        """`qpos` (N, nq), its figure higher by `height` (N,) m."""
        at = self._root
        return _replaced(
            qpos, at, qpos[:, at : at + 3] + torch.nn.functional.pad(height[:, None], (2, 0))
        )

    @staticmethod
    def _pose_columns(layout: Layout, fields: Mapping[str, Tensor]) -> Tensor:
        """(nq,) columns of the table for ``qpos``: balls are taken from the joints, which are normalised."""
        starts, at = {}, 0
        for name, value in fields.items():
            starts[name], at = at, at + value[0].numel()
        columns = starts["reference_qpos"] + torch.arange(fields["reference_qpos"].shape[1])
        balls = 4 * layout.ball_rows.unsqueeze(1) + torch.arange(4)
        columns[layout.ball_qpos] = starts["reference_joint_rotations"] + balls
        return columns

    def _carry(self, qpos: Tensor, qvel: Tensor, com: Tensor, cycles: Tensor) -> dict[str, Tensor]:
        """Move root, its velocity, and the centre of mass by `cycles` (N,) cycles."""
        at, dof = self._root, self._root_dof
        position, rotation = qpos[:, at : at + 3], qpos[:, at + 3 : at + 7]
        if self._cycle.straight:
            shift = cycles.unsqueeze(1) * self._stride
        else:
            displacement, angle = self._cycle.power(cycles)
            shift = torch.nn.functional.pad(displacement, (0, 1))
            vectors = torch.stack([position, com, qvel[:, dof : dof + 3]], dim=1)
            position, com, linear = rotations.turned(vectors, angle).unbind(1)
            rotation = rotations.multiply(rotations.from_heading(angle), rotation)
            qvel = _replaced(qvel, dof, linear)
        rotation = rotations.normalize(rotation)
        return {
            "reference_qpos": _replaced(qpos, at, position + shift, rotation),
            "reference_qvel": qvel,
            "reference_com_position": com + shift,
        }

    def to_first_cycle(
        self, qpos: Tensor, qvel: Tensor, time: Tensor
    ) -> tuple[Tensor, Tensor, Tensor]:
        """The states (N, nq), (N, nv) at `time` (N,), moved back into the first cycle."""
        at, dof = self._root, self._root_dof
        cycles = torch.floor(time / self.duration) if self.loop else torch.zeros_like(time)
        displacement, angle = self._cycle.power(cycles)
        back = rotations.from_heading(-angle)
        shift = torch.nn.functional.pad(displacement, (0, 1))
        position = rotations.rotate(back, qpos[:, at : at + 3] - shift)
        rotation = rotations.multiply(back, qpos[:, at + 3 : at + 7])
        linear = rotations.rotate(back, qvel[:, dof : dof + 3])
        return (
            _replaced(qpos, at, position, rotation),
            _replaced(qvel, dof, linear),
            time - cycles * self.duration,
        )


def _floor(state: Mapping[str, Tensor], times: Tensor, floor: Floor) -> float:
    """m: the height of the floor that the figure in `state` (F, …) at `times` (F,) moves on."""
    lowest, height = state["link_clearances"].amin(1), state["com_position"][:, 2]
    step = float(times[1] - times[0])
    reach = max(1, round(_HALF_SPAN / step))
    if floor == "lowest" or len(times) <= 2 * reach:
        return float(lowest.min())
    fall = (height[2 * reach :] - 2 * height[reach:-reach] + height[: -2 * reach]) / (
        reach * step
    ) ** 2
    carried = lowest[reach:-reach][fall > _FALLING]
    return float(carried.median() if len(carried) else lowest.min())


def _replaced(whole: Tensor, start: int, *parts: Tensor) -> Tensor:
    """`whole` (N, D) with `parts` (N, …) in the place of its columns from `start`."""
    end = start + sum(part.shape[1] for part in parts)
    return torch.cat([whole[:, :start], *parts, whole[:, end:]], dim=1)


def _lengths(model: mujoco.MjModel, layout: Layout, qpos: Tensor) -> Tensor:
    """(F, U): the actuators' lengths at `qpos`: angles of hinges, exponential maps of balls.

    They follow the pose continuously but where a ball joint passes a half turn, as MuJoCo's do.
    """
    balls = qpos[:, layout.ball_qpos.flatten()].unflatten(1, (-1, 4))
    maps = rotations.to_exponential_map(balls).flatten(1)
    rows = {address: row for row, address in enumerate(layout.ball_qpos[:, 0].tolist())}
    columns = []
    for actuator in range(model.nu):
        address = int(model.jnt_qposadr[model.actuator_trnid[actuator, 0]])
        axis = int(model.actuator_gear[actuator, :3].argmax())
        columns.append(qpos.shape[1] + 3 * rows[address] + axis if address in rows else address)
    return torch.cat([qpos, maps], dim=1)[:, columns]
