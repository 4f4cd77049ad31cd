"""Kinematics of a character for many poses at once: forward, derivatives, and steps.

F poses, J joints, D degrees of freedom: the root's translation (3) and rotation (3) along world
axes, then those of each joint in the character's order: one per hinge, and for a ball three, about
world axes. Frames are those of a clip's joints: parallel to the root's in the zero pose.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_tensors import rotations

__all__ = ["Kinematics", "Poses"]


@dataclass(frozen=True)
class Poses:
    """Where the joints are, float64."""

    #: (F, J, 3) m, world: of the point of each body that is at the joint's first hinge in the zero pose.
    positions: Tensor
    rotations: Tensor  #: (F, J, 4), world
    axes: Tensor  #: (F, D - 3, 3) world axes of the degrees of freedom that turn
    pivots: Tensor  #: (F, D - 3, 3) m, world: a point of each of these axes


class Kinematics:
    """Maps ``qpos`` of a `character`, or of one that is made larger by `size`, to the places of its joints, and derivatives of
    those back."""

    def __init__(self, character: Character, size: float = 1.0) -> None:
        self.character = character
        joints = character.joints
        self._offsets = size * torch.from_numpy(character.skeleton.offsets)
        self._rests = torch.from_numpy(character.rest_rotations.as_quat(scalar_first=True))
        self._axes = [
            rotations.rotate(rest, torch.from_numpy(joint.axes))
            for joint, rest in zip(joints, self._rests, strict=True)
        ]
        self._apart = [
            rotations.rotate(rest, size * torch.from_numpy(joint.apart))
            if joint.apart.any()
            else None
            for joint, rest in zip(joints, self._rests, strict=True)
        ]
        widths = [3 if len(joint.axes) == 0 else len(joint.axes) for joint in joints]
        columns = torch.arange(3, 3 + sum(widths)).split(widths)
        #: Of each joint, the degrees of freedom that turn it.
        self.columns = tuple(slice(int(c[0]), int(c[-1]) + 1) for c in columns)
        self.num_dofs = 3 + sum(widths)
        owner = torch.repeat_interleave(torch.arange(len(joints)), torch.tensor(widths))
        above = torch.eye(len(joints), dtype=torch.bool)
        for row, joint in enumerate(joints[1:], start=1):
            above[row] |= above[joint.parent]
        #: (D - 3,) the joint that each degree of freedom turns, the root's translations left out.
        self.owners = owner
        #: (J, J) bool: the joint of the row is that of the column, or hangs on it.
        self.hangs_on = above
        # Joints of three degrees of freedom, but the root's: rows, and their columns of qpos (B, 4) and of steps (B, 3).
        self._balls = [row for row, joint in enumerate(joints) if row and not len(joint.axes)]
        starts = torch.tensor([joints[row].addresses[0] for row in self._balls], dtype=torch.long)
        self._ball_addresses = starts[:, None] + torch.arange(4)
        starts = torch.tensor([self.columns[row].start for row in self._balls], dtype=torch.long)
        self._ball_columns = starts[:, None] + torch.arange(3)
        self._ball_parents = [joints[row].parent for row in self._balls]
        self._ball_rests = self._rests[self._balls]
        hinges = [(row, k) for row, joint in enumerate(joints) for k in range(len(joint.axes))]
        self.hinge_columns = torch.tensor(
            [self.columns[row].start + k for row, k in hinges], dtype=torch.long
        )
        self.hinge_addresses = torch.tensor(
            [joints[row].addresses[k] for row, k in hinges], dtype=torch.long
        )
        self._hinge_axes = (
            torch.stack([self._axes[row][k] for row, k in hinges])
            if hinges
            else torch.zeros(0, 3, dtype=torch.float64)
        )
        #: (H, 2) rad, infinite where a hinge is not limited.
        self.hinge_ranges = torch.tensor(
            [joints[row].ranges[k].tolist() for row, k in hinges], dtype=torch.float64
        ).reshape(-1, 2)

    def forward(self, qpos: Tensor) -> Poses:
        """The poses of ``qpos`` (F, nq)."""
        character, count = self.character, len(qpos)
        at = character.root_address
        positions, world = [qpos[:, at : at + 3]], [qpos[:, at + 3 : at + 7]]
        about_world = torch.eye(3, dtype=torch.float64).expand(count, 3, 3)
        axes = [about_world]
        pivots = [positions[0][:, None].expand(count, 3, 3)]
        balls, hinges = self._turns(qpos)
        for row, joint in enumerate(character.joints[1:], start=1):
            place, turn = positions[joint.parent], world[joint.parent]
            place = place + rotations.rotate(turn, self._offsets[row])
            if len(joint.axes) == 0:
                turn = rotations.multiply(turn, next(balls))
                axes.append(about_world)
                pivots.append(place[:, None].expand(count, 3, 3))
            apart = self._apart[row]
            for k, axis in enumerate(self._axes[row]):
                axes.append(rotations.rotate(turn, axis)[:, None])
                pivot = place if apart is None else place + rotations.rotate(turn, apart[k])
                pivots.append(pivot[:, None])
                turn = rotations.multiply(turn, next(hinges))
                place = place if apart is None else pivot - rotations.rotate(turn, apart[k])
            positions.append(place)
            world.append(turn)
        return Poses(
            *(torch.stack(x, 1) for x in (positions, world)),
            *(torch.cat(x, 1) for x in (axes, pivots)),
        )

    def _turns(self, qpos: Tensor) -> tuple[Iterator[Tensor], Iterator[Tensor]]:
        """The turns (F, 4) of joints of three degrees of freedom, and of hinges, in their order: all at once, since each
        operation on so little takes as long as on all."""
        local = rotations.multiply(self._ball_rests, qpos[:, self._ball_addresses])
        balls = rotations.multiply(local, rotations.conjugate(self._ball_rests))
        hinges = rotations.from_axis_angle(self._hinge_axes, qpos[:, self.hinge_addresses])
        return iter(balls.unbind(1)), iter(hinges.unbind(1))

    def aimed(self, position: Tensor, goals: Mapping[int, Tensor]) -> Tensor:
        """``qpos`` (F, nq) with the root at `position` (F, 3). Each joint turns as near to its goal as it can, given how far
        those before it got; a joint without a goal is in the zero pose.

        Parameters
        ----------
        position
            (F, 3) m, world.
        goals
            by joint, the root (0) among them: its rotation (F, 4), world.
        """
        character = self.character
        result = torch.tensor(character.model.qpos0, dtype=torch.float64).repeat(len(position), 1)
        at = character.root_address
        result[:, at : at + 3], result[:, at + 3 : at + 7] = position, goals[0]
        world = [goals[0]]
        for row, joint in enumerate(character.joints[1:], start=1):
            above, rest = world[joint.parent], self._rests[row]
            local = rotations.multiply(rotations.conjugate(above), goals.get(row, above))
            turned = rotations.multiply(rotations.conjugate(rest), rotations.multiply(local, rest))
            addresses = list(joint.addresses)
            if len(joint.axes) == 0:
                start = addresses[0]
                result[:, start : start + 4] = turned
                world.append(rotations.multiply(above, local))
                continue
            limits = torch.from_numpy(joint.ranges)
            angles = joint.angles(turned)
            result[:, addresses] = angles.clamp(limits[:, 0], limits[:, 1])
            for axis, address in zip(self._axes[row], addresses, strict=True):
                hinge = rotations.from_axis_angle(axis, result[:, address])
                above = rotations.multiply(above, hinge)
            world.append(above)
        return result

    def moved(self, qpos: Tensor, poses: Poses, step: Tensor) -> Tensor:
        """``qpos`` (F, nq) after `step` (F, D) from `poses`; hinges stay within their ranges."""
        result = qpos.clone()
        at = self.character.root_address
        result[:, at : at + 3] += step[:, :3]
        turn = rotations.from_exponential_map(step[:, 3:6])
        root = rotations.multiply(turn, qpos[:, at + 3 : at + 7])
        result[:, at + 3 : at + 7] = rotations.normalize(root)
        above = poses.rotations[:, self._ball_parents]
        about = rotations.inverse_rotate(above, step[:, self._ball_columns])
        turn = rotations.from_exponential_map(rotations.inverse_rotate(self._ball_rests, about))
        ball = rotations.multiply(turn, qpos[:, self._ball_addresses])
        result[:, self._ball_addresses] = rotations.normalize(ball)
        result[:, self.hinge_addresses] += step[:, self.hinge_columns]
        return self.within_ranges(result)

    def within_ranges(self, qpos: Tensor) -> Tensor:
        """``qpos`` (F, nq) with hinges clamped to their ranges."""
        low, high = self.hinge_ranges.unbind(-1)
        angles = torch.minimum(torch.maximum(qpos[:, self.hinge_addresses], low), high)
        return qpos.index_copy(1, self.hinge_addresses, angles)
