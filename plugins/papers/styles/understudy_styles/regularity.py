"""The regularisation term (thesis, eq. 3.7)."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.options import check_range
from understudy.task import Context, Fields, Shape
from understudy_characters.scene import CharacterScene
from understudy_tensors.rotations import turn_matrix


class Accelerations(Fields):
    """How fast velocities changed over the last decision; 0 when an episode begins.

    ``link_accelerations`` (N, L) m/s², of the links' origins in the world; ``joint_accelerations``
    (N, J) rad/s², of the joints relative to their parents.
    """

    reads = (
        "link_linear_velocities", "previous_link_linear_velocities", "root_heading",
        "previous_root_heading", "qvel", "previous_qvel",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {"link_accelerations": (0,), "joint_accelerations": (0,)}

    def __init__(self, options: None, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "fields 'styles/accelerations'").layout
        links, joints = len(layout.link_names), len(layout.joint_names)
        self.provides = {"link_accelerations": (links,), "joint_accelerations": (joints,)}
        own = layout.to(context.device)
        self._balls, self._hinges, self._used = own.ball_dofs, own.hinge_dofs, own.hinge_used
        self._rows = own.joint_rows
        self._dt = context.control_dt * context.decision

    def compute(
        self,
        link_linear_velocities: Tensor,
        previous_link_linear_velocities: Tensor,
        root_heading: Tensor,
        previous_root_heading: Tensor,
        qvel: Tensor,
        previous_qvel: Tensor,
    ) -> Mapping[str, Tensor]:
        after = torch.bmm(link_linear_velocities, turn_matrix(root_heading).mT)
        before = torch.bmm(previous_link_linear_velocities, turn_matrix(previous_root_heading).mT)
        change = (qvel - previous_qvel) / self._dt
        balls = change[:, self._balls.flatten()].view(len(change), *self._balls.shape).norm(dim=2)
        hinges = change[:, self._hinges.flatten()].view(len(change), *self._hinges.shape)
        hinges = (hinges * self._used).norm(dim=2)
        return {
            "link_accelerations": ((after - before) / self._dt).norm(dim=2),
            "joint_accelerations": torch.cat([balls, hinges], dim=1)[:, self._rows],
        }


class Regularity:
    """exp(-Σ wᵢ aᵢ / βᵢ) over the kinetic energy, the links' and the joints' accelerations (eq. 3.7).

    The paper prints neither w nor β. All N = 1 + L + J weights are 1 / N here, and each β is
    about what a generated walk has at its fastest.
    """

    @dataclass(frozen=True)
    class Options:
        energy: float = 100.0  #: β of the kinetic energy, J, above 0
        link: float = 50.0  #: β of the links' accelerations, m/s², above 0
        joint: float = 200.0  #: β of the joints' accelerations, rad/s², above 0

        def __post_init__(self) -> None:
            check_range(self, "link", most=1e4)
            check_range(self, "joint", most=1e5)
            check_range(self, "energy", "link", "joint", above=0)

    def __init__(self, options: Options, context: Context) -> None:
        self._options = options

    def __call__(
        self, kinetic_energy: Tensor, link_accelerations: Tensor, joint_accelerations: Tensor
    ) -> Tensor:
        options = self._options
        count = 1 + link_accelerations.shape[1] + joint_accelerations.shape[1]
        total = (
            kinetic_energy / options.energy
            + link_accelerations.sum(1) / options.link
            + joint_accelerations.sum(1) / options.joint
        )
        return torch.exp(-total / count)
