"""The character's state as tasks see it, batched over worlds (N) or frames.

The heading frame has its origin at the root, z up, and x along the root's heading: coordinates in it do not depend
on where the character is and which way it faces.
"""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.kinematics import Kinematics
from understudy_characters.layout import Layout
from understudy_characters.surface import Surface, lowest_points, surface_of
from understudy_tensors import rotations

__all__ = ["character_state", "joint_rotations"]


def joint_rotations(layout: Layout, qpos: Tensor) -> Tensor:
    """(N, J, 4): each joint's rotation from the zero pose, in its body's frame there.

    Several hinges of one body are one joint, turned about one after the other.
    """
    balls = qpos.index_select(1, layout.ball_qpos.flatten()).view(len(qpos), -1, 4)
    angles = qpos.index_select(1, layout.hinge_qpos.flatten())
    angles = angles.view(len(qpos), *layout.hinge_qpos.shape)
    axes = layout.hinge_axes.to(qpos.dtype)
    turns = rotations.from_axis_angle(axes, angles * layout.hinge_used.to(qpos.dtype))
    hinges = turns[:, :, 0]
    for k in range(1, turns.shape[2]):
        hinges = rotations.multiply(hinges, turns[:, :, k])
    return torch.cat([balls, hinges], dim=1).index_select(1, layout.joint_rows)


def character_state(
    layout: Layout,
    *,
    qpos: Tensor,
    xpos: Tensor,
    xmat: Tensor,
    xipos: Tensor,
    cvel: Tensor,
    subtree_com: Tensor,
) -> dict[str, Tensor]:
    """Derived state from MuJoCo's ``qpos`` (N, nq), ``xpos`` (N, bodies, 3) and so on.

    Returns
    -------
    com_position (N, 3), root_position (N, 3), root_rotation (N, 4), root_heading (N,) : world frame
    joint_rotations (N, J, 4) : :func:`joint_rotations`
    link_positions (N, L, 3) : heading frame
    link_rotations (N, L, 6) : heading frame, the link's x and z axes
    link_linear_velocities, link_angular_velocities (N, L, 3) : along the heading frame's axes, of
        the link's origin, relative to the world; m/s and rad/s
    end_effector_positions (N, E, 3) : heading frame, the end-effectors' centres of mass
    """
    links, at = layout.link_bodies, layout.root_address
    # index_select takes a quarter of the time of indexing on a CPU.
    position, motion = (value.index_select(1, links) for value in (xpos, cvel))
    axes = xmat.flatten(1).index_select(1, layout.link_axes).unflatten(1, (-1, 3))
    root_position, root_rotation = qpos[:, at : at + 3], qpos[:, at + 3 : at + 7]
    com = subtree_com[:, layout.root_body]
    yaw = rotations.heading(root_rotation)
    # cvel is [angular, linear], both along world axes, linear at the character's centre of mass.
    angular, linear = motion.split(3, dim=-1)
    linear = linear + torch.linalg.cross(angular, position - com.unsqueeze(1))
    origin = root_position.unsqueeze(1)
    effectors = xipos.index_select(1, layout.effector_bodies) - origin
    parts = [position - origin, linear, angular, axes, effectors]
    local = rotations.turned(torch.cat(parts, dim=1), -yaw)
    position, linear, angular, axes, effectors = local.split([p.shape[1] for p in parts], dim=1)
    return {
        "com_position": com,
        "root_position": root_position,
        "root_rotation": root_rotation,
        "root_heading": yaw,
        "joint_rotations": joint_rotations(layout, qpos),
        "link_positions": position,
        "link_rotations": axes.unflatten(1, (-1, 2)).flatten(2),
        "link_linear_velocities": linear,
        "link_angular_velocities": angular,
        "end_effector_positions": effectors,
    }


class Poses:
    """The fields of :func:`character_state` without velocities, for poses that are not in a simulator."""

    def __init__(self, character: Character, layout: Layout) -> None:
        self._kinematics, self._layout = Kinematics(character), layout
        self._surface: Surface = surface_of(character, layout.link_names, layout)
        model, data = character.model, character.zero_pose
        bodies = layout.link_bodies.tolist()
        root = data.xmat[character.root].reshape(3, 3)
        carriers = [character.carrier[body] for body in bodies]
        origins = character.rest_positions[carriers]

        def in_root(points: np.ndarray) -> Tensor:
            return torch.from_numpy((points - data.xpos[character.root]) @ root - origins)

        #: Of each link in the zero pose, from the joint that carries it, in the root's frame.
        self._carriers = torch.tensor(carriers)
        self._offsets = torch.stack([in_root(data.xpos[bodies]), in_root(data.xipos[bodies])])
        turned = rotations.conjugate(torch.from_numpy(data.xquat[character.root].copy()))
        self._turns = rotations.multiply(turned, torch.from_numpy(data.xquat[bodies]))
        masses = torch.from_numpy(model.body_mass[bodies])
        self._shares = masses / masses.sum()
        self._effectors = torch.tensor(
            [bodies.index(body) for body in layout.effector_bodies.tolist()], dtype=torch.long
        )

    def state(self, qpos: Tensor) -> dict[str, Tensor]:
        """Of ``qpos`` (F, nq) float64: the fields of :func:`character_state` that have no velocities
        and are not of links, and ``link_clearances`` (F, L) m, how high each link's lowest point is."""
        posed = self._kinematics.forward(qpos)
        turn = posed.rotations[:, self._carriers]
        places = posed.positions[:, self._carriers] + rotations.rotate(turn, self._offsets[:, None])
        position, centre = places.unbind(0)
        root_position, root_rotation = posed.positions[:, 0], posed.rotations[:, 0]
        yaw = rotations.heading(root_rotation)
        effectors = centre[:, self._effectors] - root_position[:, None]
        up = rotations.to_matrix(rotations.multiply(turn, self._turns))[..., 2, :]
        return {
            "com_position": (centre * self._shares[:, None]).sum(1),
            "root_position": root_position,
            "root_rotation": root_rotation,
            "root_heading": yaw,
            "joint_rotations": joint_rotations(self._layout, qpos),
            "end_effector_positions": rotations.turned(effectors, -yaw),
            "link_clearances": lowest_points(self._surface, position[..., 2], up),
        }


@lru_cache(maxsize=8)  # each clip of a character asks for it anew
def poses_of(character: Character, layout: Layout) -> Poses:
    """Of this very character and layout."""
    return Poses(character, layout)
