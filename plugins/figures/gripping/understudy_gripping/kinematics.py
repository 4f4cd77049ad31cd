"""Where the links of a hand are, for many poses at once, in torch and so with gradients.

B candidates, H hinges and L links of the hand, C capsules, S boxes. Everything in the palm's frame, m.
"""

from __future__ import annotations

from dataclasses import dataclass

import mujoco
import numpy as np
import torch
from torch import Tensor

from understudy_hand.scene import HandScene
from understudy_tensors import rotations

__all__ = ["HandKinematics"]


@dataclass(frozen=True)
class Placed:
    """The shapes of the hand."""

    ends: Tensor  #: (B, C, 2, 3) of the capsules' axes
    boxes: Tensor  #: (B, S, 3) their middles
    turns: Tensor  #: (B, S, 3, 3) their axes as columns


class HandKinematics:
    """Forward kinematics of what hangs on the palm of a hand; float64, on the CPU."""

    def __init__(self, scene: HandScene) -> None:
        model = scene.model
        palm = model.body("palm").id
        self.names = [n for n in scene.links if palm in _above(model, model.body(n).id)]
        bodies = [model.body(name).id for name in self.names]
        row = {body: k for k, body in enumerate(bodies)} | {palm: -1}
        self._parents = [row[int(model.body_parentid[body])] for body in bodies]
        self._offsets = _tensor(model.body_pos[bodies])
        self._turns = _tensor([_matrix(model.body_quat[body]) for body in bodies])
        straight = torch.eye(3, dtype=torch.float64)
        self._turned = (self._turns != straight).flatten(1).any(1).tolist()  # from its parent
        joints = [j for b in bodies for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])]  # fmt: skip
        #: Names of the hinges, in the model's order.
        self.hinges = [model.joint(j).name for j in joints]
        self._hinges_of = [
            [joints.index(j) for j in range(model.body_jntadr[b], model.body_jntadr[b] + model.body_jntnum[b])]
            for b in bodies
        ]  # fmt: skip
        #: (H, 2) rad
        self.ranges = _tensor(model.jnt_range[joints])
        self._anchors = _tensor(model.jnt_pos[joints])
        self._off = self._anchors.any(1).tolist()  # whether a hinge is beside its link's origin
        axes = _tensor(model.jnt_axis[joints])
        self._skew = torch.linalg.cross(
            axes[:, :, None].expand(-1, 3, 3),
            torch.eye(3, dtype=torch.float64).expand(len(axes), 3, 3),
            dim=1,
        )
        self._square = self._skew @ self._skew
        geoms = {n: model.geom(n) for n in self.names if model.body(n).geomnum[0]}
        capsule = int(mujoco.mjtGeom.mjGEOM_CAPSULE)
        #: Links that are capsules, and their radii (C,) m.
        self.capsules = [n for n in geoms if int(geoms[n].type[0]) == capsule]
        self.boxes = [n for n in geoms if n not in self.capsules]
        self.radii = _tensor([geoms[n].size[0] for n in self.capsules])
        self.box_sizes = _tensor([geoms[n].size for n in self.boxes]).reshape(-1, 3)
        self._capsule_rows = torch.tensor([self.names.index(n) for n in self.capsules])
        self._box_rows = torch.tensor([self.names.index(n) for n in self.boxes], dtype=torch.long)
        ends = []
        for name in self.capsules:
            geom, turn = geoms[name], _matrix(geoms[name].quat)
            ends.append([geom.pos + way * geom.size[1] * turn[:, 2] for way in (-1, 1)])
        self._ends = _tensor(np.array(ends))
        self._box_places = _tensor([geoms[n].pos for n in self.boxes]).reshape(-1, 3)
        self._box_turns = _tensor([_matrix(geoms[n].quat) for n in self.boxes]).reshape(-1, 3, 3)

    def links(self, pose: Tensor) -> tuple[Tensor, Tensor]:
        """Positions (B, L, 3) and matrices (B, L, 3, 3) of the links at the angles `pose` (B, H) rad."""
        count = len(pose)
        sine, cosine = pose.sin()[..., None, None], pose.cos()[..., None, None]
        turns = torch.eye(3, dtype=pose.dtype) + sine * self._skew + (1.0 - cosine) * self._square
        by_hinge = turns.unbind(1)
        places: list[Tensor] = []
        matrices: list[Tensor] = []
        for link, parent in enumerate(self._parents):
            if parent < 0:
                place = self._offsets[link].expand(count, 3)
                matrix = self._turns[link].expand(count, 3, 3)
            else:
                place = places[parent] + matrices[parent] @ self._offsets[link]
                matrix = matrices[parent]
                if self._turned[link]:
                    matrix = matrix @ self._turns[link]
            for hinge in self._hinges_of[link]:
                turned = matrix @ by_hinge[hinge]
                if self._off[hinge]:
                    anchor = self._anchors[hinge]
                    place = place + matrix @ anchor - turned @ anchor
                matrix = turned
            places.append(place)
            matrices.append(matrix)
        return torch.stack(places, 1), torch.stack(matrices, 1)

    def shapes(self, pose: Tensor) -> Placed:
        """The shapes at the angles `pose` (B, H) rad."""
        places, matrices = self.links(pose)
        rows = self._capsule_rows
        ends = places[:, rows, None] + torch.einsum("bcij,cej->bcei", matrices[:, rows], self._ends)
        boxes = self._box_rows
        middles = places[:, boxes] + torch.einsum(
            "bsij,sj->bsi", matrices[:, boxes], self._box_places
        )
        return Placed(ends, middles, matrices[:, boxes] @ self._box_turns)


def stick_ends(position: Tensor, rotation: Tensor, half_length: float) -> Tensor:
    """(…, 2, 3) m: tip and end of a stick at `position` (…, 3), `rotation` (…, 4)."""
    along = rotation.new_tensor([[-half_length, 0.0, 0.0], [half_length, 0.0, 0.0]])
    return position[..., None, :] + rotations.rotate(rotation[..., None, :], along)


def _above(model: mujoco.MjModel, body: int) -> set[int]:
    """The bodies on which `body` hangs."""
    found = set()
    while body:
        body = int(model.body_parentid[body])
        found.add(body)
    return found


def _matrix(quaternion: np.ndarray) -> np.ndarray:
    matrix = np.zeros(9)
    mujoco.mju_quat2Mat(matrix, np.asarray(quaternion, np.float64))
    return matrix.reshape(3, 3)


def _tensor(values: object) -> Tensor:
    return torch.as_tensor(np.asarray(values, np.float64))
