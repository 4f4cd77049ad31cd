"""What a pose auto-encoder sees of a pose (thesis, section 4.4.2), and a pose from what it makes.

A pose is the rotations of a figure's joints relative to their parents, as a clip has them; where the root
is and how it is turned is no part of it. F poses, J joints without the root, L links.
"""

from __future__ import annotations

import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_tensors import rotations


class PoseFeatures:
    """6-D rotations of all joints, positions of all joints, positions of all links' centres of mass:
    (F, 9 J + 3 L), m, in the root's frame."""

    def __init__(self, character: Character) -> None:
        self.character = character
        self.joints = character.joint_names[1:]
        data = character.zero_pose
        root = torch.from_numpy(data.xmat[character.root].reshape(3, 3).copy())
        bodies = sorted(character.carrier)
        self._carriers = [character.carrier[body] for body in bodies]
        centres = torch.from_numpy(data.xipos[bodies] - data.xpos[character.root]) @ root
        #: (L, 3) m, of each link's centre of mass from the joint that carries it, in the zero pose.
        self._centres = centres - torch.from_numpy(character.rest_positions[self._carriers])
        self.size = 9 * len(self.joints) + 3 * len(bodies)

    def clip(self, local: Tensor) -> Clip:
        """The poses `local` (F, J, 4), F > 1, as a clip whose root stays where it is, a second each."""
        count = len(local)
        root = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(count, 1, 4)
        return Clip(
            name="poses",
            times=torch.arange(count, dtype=torch.float64),
            root_position=torch.zeros(count, 3, dtype=torch.float64),
            rotations=torch.cat([root, local.double().cpu()], dim=1),
            joint_names=self.character.joint_names,
            loop=False,
            skeleton=self.character.skeleton,
        )

    def places(self, local: Tensor) -> Tensor:
        """(F, J + T, 3) m: where the joints of the poses `local` (F, J, 4), F > 1, and the T tips of the
        figure are, in the root's frame; float64."""
        clip = self.clip(local)
        positions, world = forward_kinematics(clip)
        return torch.cat([positions[:, 1:], tip_positions(clip, positions, world)], dim=1)

    def of(self, local: Tensor) -> Tensor:
        """The features (F, D) float32 of the poses `local` (F, J, 4), F > 1."""
        positions, world = forward_kinematics(self.clip(local))
        turned = rotations.rotate(world[:, self._carriers], self._centres)
        parts = (
            rotations.tangent_normal(local.double().cpu()),
            positions[:, 1:],
            positions[:, self._carriers] + turned,
        )
        return torch.cat([part.flatten(1) for part in parts], dim=1).float()

    def rotations(self, features: Tensor) -> Tensor:
        """The poses (…, J, 4) whose 6-D rotations `features` (…, D) has; its positions are not used."""
        return joint_rotations(features, len(self.joints))


def joint_rotations(features: Tensor, joints: int) -> Tensor:
    """Unit quaternions (…, J, 4) from 6-D rotations, the first 6 J of `features` (…, D): the x axis as it
    is, the z axis at a right angle to it (Zhou et al. 2019)."""
    axes = features[..., : 6 * joints].unflatten(-1, (joints, 2, 3))
    x = torch.nn.functional.normalize(axes[..., 0, :], dim=-1)
    z = axes[..., 1, :]
    z = torch.nn.functional.normalize(z - (x * z).sum(-1, keepdim=True) * x, dim=-1)
    return _quaternion(torch.stack([x, torch.linalg.cross(z, x), z], dim=-1))


def _quaternion(matrix: Tensor) -> Tensor:
    """Unit quaternions (…, 4) of rotation matrices (…, 3, 3).

    Of the four ways to write it, each a multiple of the quaternion, the longest loses no digits.
    """
    (a, b, c), (d, e, f), (g, h, i) = (row.unbind(-1) for row in matrix.unbind(-2))
    ways = torch.stack([
        torch.stack([1 + a + e + i, h - f, c - g, d - b], dim=-1),
        torch.stack([h - f, 1 + a - e - i, b + d, c + g], dim=-1),
        torch.stack([c - g, b + d, 1 - a + e - i, f + h], dim=-1),
        torch.stack([d - b, c + g, f + h, 1 - a - e + i], dim=-1),
    ], dim=-2)  # fmt: skip
    longest = torch.diagonal(ways, dim1=-2, dim2=-1).argmax(dim=-1)
    chosen = longest[..., None, None].expand(*longest.shape, 1, 4)
    return rotations.normalize(ways.gather(-2, chosen).squeeze(-2))
