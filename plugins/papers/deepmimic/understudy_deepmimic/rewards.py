"""The imitation reward (Peng et al. 2018, section 5.3): r = 0.65 r_p + 0.1 r_v + 0.15 r_e + 0.1 r_c.

Each term is in (0, 1], and 1 where the character is as its reference. The weights stand in
``conf/reward/deepmimic.yaml``.
"""

from __future__ import annotations

from dataclasses import dataclass

import torch
from torch import Tensor
from torch.nn.functional import pad

from understudy.options import check_range
from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_tensors.limits import limits
from understudy_tensors.rotations import angle_between, turn_matrix


@limits(scale=(0, 1e6))
def pose(
    root_rotation: Tensor,
    joint_rotations: Tensor,
    reference_root_rotation: Tensor,
    reference_joint_rotations: Tensor,
    *,
    scale: float = 2.0,  #: 1/rad², factor of the summed squared angles (section 5.3)
) -> Tensor:
    """r_p = exp(-2 Σ_j ‖q̂_j ⊖ q_j‖²), the angles in rad between orientations of the joints, (N, J, 4)
    relative to their parents, and of the root, (N, 4) in the world."""
    own = torch.cat([root_rotation.unsqueeze(1), joint_rotations], dim=1)
    reference = torch.cat([reference_root_rotation.unsqueeze(1), reference_joint_rotations], dim=1)
    return torch.exp(-scale * angle_between(own, reference).square().sum(dim=1))


class Velocity:
    """r_v = exp(-0.1 Σ_j ‖ω̂_j - ω_j‖²), the angular velocities in rad/s of the joints relative to their
    parents and of the root, each in its own frame."""

    @dataclass(frozen=True)
    class Options:
        scale: float = 0.1  #: s²/rad², factor of the summed squared velocities (section 5.3)

        def __post_init__(self) -> None:
            check_range(self, "scale", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "reward 'deepmimic/velocity'").layout
        root = layout.root_dof + torch.arange(3, 6)
        hinges = layout.hinge_dofs[layout.hinge_used.bool()]
        self._turning = torch.cat([root, layout.ball_dofs.flatten(), hinges]).to(context.device)
        self._scale = options.scale

    def __call__(self, qvel: Tensor, reference_qvel: Tensor) -> Tensor:
        difference = (reference_qvel - qvel)[:, self._turning]
        return torch.exp(-self._scale * difference.square().sum(dim=1))


@limits(scale=(0, 1e6))
def end_effectors(
    root_position: Tensor,
    root_heading: Tensor,
    end_effector_positions: Tensor,
    reference_root_position: Tensor,
    reference_root_heading: Tensor,
    reference_end_effector_positions: Tensor,
    *,
    scale: float = 40.0,  #: 1/m², factor of the summed squared distances (section 5.3)
) -> Tensor:
    """r_e = exp(-40 Σ_e ‖p̂_e - p_e‖²), the positions in m of hands and feet along world axes.

    They are relative to the root horizontally and to the floor vertically, as in the released system,
    so that where the character has got to counts in r_c alone. `end_effector_positions` (N, E, 3) are
    given in the heading frame, whose direction jumps in a flip; world axes do not.
    """
    own = torch.bmm(end_effector_positions, turn_matrix(root_heading).mT)
    turn = turn_matrix(reference_root_heading).mT
    reference = torch.bmm(reference_end_effector_positions, turn)
    lower = pad((reference_root_position - root_position)[:, 2:], (2, 0)).unsqueeze(1)
    return torch.exp(-scale * (reference - own + lower).square().sum(dim=(1, 2)))


@limits(scale=(0, 1e6))
def com(
    com_position: Tensor,
    reference_com_position: Tensor,
    *,
    scale: float = 10.0,  #: 1/m², factor of the squared distance (section 5.3)
) -> Tensor:
    """r_c = exp(-10 ‖ĉ - c‖²), the centres of mass (N, 3) in m in the world."""
    return torch.exp(-scale * (reference_com_position - com_position).square().sum(dim=1))


class Imitation:
    """r of the paper's section 5.3 as one term, to be multiplied or averaged with others: r_i of the
    thesis' eq. 3.11."""

    @dataclass(frozen=True)
    class Options:
        pose: float = 0.65  #: weight of r_p, from 0 (section 5.3)
        velocity: float = 0.1  #: weight of r_v (section 5.3)
        end_effectors: float = 0.15  #: weight of r_e (section 5.3)
        com: float = 0.1  #: weight of r_c (section 5.3)

        def __post_init__(self) -> None:
            check_range(self, "pose", "velocity", "end_effectors", "com", least=0)
            if self.pose == self.velocity == self.end_effectors == self.com == 0:
                raise ValueError(
                    "pose=0 is not possible with velocity=0, end_effectors=0 and com=0: the reward would be 0 whatever "
                    "happens."
                )

    def __init__(self, options: Options, context: Context) -> None:
        self._weights, self._velocity = options, Velocity(Velocity.Options(), context)

    def __call__(
        self,
        qvel: Tensor,
        reference_qvel: Tensor,
        root_rotation: Tensor,
        joint_rotations: Tensor,
        reference_root_rotation: Tensor,
        reference_joint_rotations: Tensor,
        root_position: Tensor,
        root_heading: Tensor,
        end_effector_positions: Tensor,
        reference_root_position: Tensor,
        reference_root_heading: Tensor,
        reference_end_effector_positions: Tensor,
        com_position: Tensor,
        reference_com_position: Tensor,
    ) -> Tensor:
        weights = self._weights
        r_p = pose(
            root_rotation, joint_rotations, reference_root_rotation, reference_joint_rotations
        )
        r_v = self._velocity(qvel, reference_qvel)
        r_e = end_effectors(
            root_position, root_heading, end_effector_positions,
            reference_root_position, reference_root_heading, reference_end_effector_positions,
        )  # fmt: skip
        r_c = com(com_position, reference_com_position)
        return (
            weights.pose * r_p
            + weights.velocity * r_v
            + weights.end_effectors * r_e
            + weights.com * r_c
        )
