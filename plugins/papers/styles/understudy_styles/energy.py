"""Kinetic energy in the frame of the centre of mass (thesis, section 3.3.3)."""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from understudy.task import Context, Fields, Shape
from understudy_characters.scene import CharacterScene
from understudy_tensors import rotations


class KineticEnergy(Fields):
    """``kinetic_energy`` (N,) J of the links' motion relative to the centre of mass, which moves with it
    and does not turn: E = Σ ½ mᵢ ‖vᵢ - v‖² + ½ ωᵢᵀ Iᵢ ωᵢ."""

    reads = ("xquat", "xipos", "cvel", "subtree_com")
    provides: Mapping[str, Shape] = {"kinetic_energy": ()}

    def __init__(self, options: None, context: Context) -> None:
        scene = context.need_scene(CharacterScene, "fields 'styles/energy'")
        model, device = scene.model, context.device
        bodies = scene.layout.link_bodies

        def tensor(values: object) -> Tensor:
            return torch.as_tensor(values, dtype=torch.float32)[bodies].to(device)

        self._bodies, self._root = bodies.to(device), scene.layout.root_body
        self._masses, self._inertias = tensor(model.body_mass), tensor(model.body_inertia)
        self._turns = tensor(model.body_iquat)

    def compute(
        self, xquat: Tensor, xipos: Tensor, cvel: Tensor, subtree_com: Tensor
    ) -> Mapping[str, Tensor]:
        angular, linear = cvel[:, self._bodies].split(3, dim=2)  # linear at the centre of mass
        arms = xipos[:, self._bodies] - subtree_com[:, self._root].unsqueeze(1)
        linear = linear + torch.linalg.cross(angular, arms)
        masses = self._masses.unsqueeze(1)
        away = linear - (masses * linear).sum(1, keepdim=True) / masses.sum()
        axes = rotations.multiply(xquat[:, self._bodies], self._turns)
        own = rotations.inverse_rotate(axes, angular)  # along the axes of inertia
        twice = masses * away.square() + self._inertias * own.square()
        return {"kinetic_energy": 0.5 * twice.sum(dim=(1, 2))}
