"""What a standing character feels."""

import torch
from torch import Tensor

from understudy.interfaces import Context, Encoder
from understudy_humanoid.scene import HumanoidScene


class Posture(Encoder):
    """Joint rotations, trunk rotation and all velocities, (N, 4 J + 4 + 34)."""

    reads = ("joint_rotations", "root_rotation", "qvel")

    def __init__(self, options: None, context: Context) -> None:
        joints = len(
            context.need_scene(HumanoidScene, "encoder 'balance.posture'").layout.joint_names
        )
        self.shape = (4 * joints + 4 + 34,)

    def encode(self, joint_rotations: Tensor, root_rotation: Tensor, qvel: Tensor) -> Tensor:
        return torch.cat([joint_rotations.flatten(1), root_rotation, qvel], dim=1)
