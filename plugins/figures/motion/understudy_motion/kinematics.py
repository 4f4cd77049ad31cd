"""Where the joints of a clip's figure are in the world."""

from __future__ import annotations

import shlex

import torch
from torch import Tensor

from understudy.errors import FileError
from understudy_motion.clip import ANGLE, Clip, Skeleton
from understudy_tensors import rotations

__all__ = ["forward_kinematics", "need_skeleton", "tip_positions"]


def need_skeleton(clip: Clip) -> Skeleton:
    """The clip's skeleton, whose joints are the clip's in the clip's order.

    Raises
    ------
    FileError
        the clip has none, or one of other joints.
    """
    skeleton = clip.skeleton
    if skeleton is None and any(name.startswith(ANGLE) for name in clip.joint_names):
        raise FileError(
            f"Clip {clip.source} has a robot's angles in place of joints. Make it one of the robot's: "
            f"understudy motion check {shlex.quote(clip.source)} --character ROBOT.xml --fix OUT.npz."
        )
    if skeleton is None:
        raise FileError(
            f"Clip {clip.source}: has no skeleton (the lengths between its joints), which this needs."
        )
    if skeleton.joint_names != clip.joint_names:
        raise FileError(f"Clip {clip.source}: its skeleton's joints are not the clip's.")
    return skeleton


def forward_kinematics(clip: Clip) -> tuple[Tensor, Tensor]:
    """World positions and rotations of all joints in all frames, float64.

    Returns
    -------
    tuple[Tensor, Tensor]
        Positions (F, J, 3) m and rotations (F, J, 4).

    Raises
    ------
    FileError
        as :func:`need_skeleton`.
    """
    skeleton = need_skeleton(clip)
    offsets = torch.as_tensor(skeleton.offsets, dtype=torch.float64)
    positions, world = [clip.root_position], [clip.rotations[:, 0]]
    for joint, parent in enumerate(skeleton.parents[1:], start=1):
        positions.append(positions[parent] + rotations.rotate(world[parent], offsets[joint]))
        world.append(rotations.multiply(world[parent], clip.rotations[:, joint]))
    return torch.stack(positions, dim=1), torch.stack(world, dim=1)


def tip_positions(clip: Clip, positions: Tensor, world: Tensor) -> Tensor:
    """World positions (F, T, 3) m of the skeleton's tips, in their order there.

    Parameters
    ----------
    clip
        the clip, whose skeleton may have no tips (T = 0).
    positions
        (F, J, 3), of :func:`forward_kinematics`.
    world
        (F, J, 4), of :func:`forward_kinematics`.

    Raises
    ------
    FileError
        as :func:`need_skeleton`.
    """
    tips = need_skeleton(clip).tips
    joints = [clip.joint_names.index(name) for name in tips]
    offsets = torch.zeros(len(tips), 3, dtype=torch.float64)
    for row, offset in enumerate(tips.values()):
        offsets[row] = torch.as_tensor(offset)
    return positions[:, joints] + rotations.rotate(world[:, joints], offsets)
