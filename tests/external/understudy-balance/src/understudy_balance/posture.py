"""What a standing character feels."""

import torch
from torch import Tensor

from understudy.task import Context, Encoder
from understudy_characters.scene import CharacterScene


class Posture(Encoder):
    """Joint rotations, trunk rotation and all velocities, (N, 4 J + 4 + nv)."""

    reads = ("joint_rotations", "root_rotation", "qvel")

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "encoder 'balance/posture'")
        self.shape = (4 * len(scene.layout.joint_names) + 4 + scene.model.nv,)

    def encode(self, joint_rotations: Tensor, root_rotation: Tensor, qvel: Tensor) -> Tensor:
        return torch.cat([joint_rotations.flatten(1), root_rotation, qvel], dim=1)
