"""What the policy observes (Peng et al. 2018, section 5.1)."""

from __future__ import annotations

import math
from dataclasses import dataclass

import torch
from torch import Tensor

from understudy.task import Context, Encoder, Shape
from understudy_characters.layout import LINK_COLUMNS, columns
from understudy_characters.scene import CharacterScene
from understudy_tensors.rotations import turn_matrix


class StateEncoder(Encoder):
    """Phase, the root's height, and of each link position, rotation, linear and angular velocity,
    relative to the root in its heading frame.

    ``deviation`` adds the root's position and heading relative to the reference's. The reward depends on
    both, and without them a character that has drifted away cannot come back; the released system instead moves
    the reference to the character whenever the clip begins anew. Rotations are two axes (6
    numbers) rather than quaternions, which jump in sign; the phase comes with its sine and cosine, so
    that a cycle has no seam.
    """

    @dataclass(frozen=True)
    class Options:
        deviation: bool = True  #: whether the policy sees how far it is from the reference

    shape: Shape

    def __init__(self, options: Options, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "encoder 'deepmimic/state'").layout
        self._deviation = options.deviation
        self.reads = (
            "phase", "root_position",
            "link_positions", "link_rotations", "link_linear_velocities", "link_angular_velocities",
        )  # fmt: skip
        if options.deviation:
            self.reads += ("root_heading", "reference_root_position", "reference_root_heading")
        self.columns = ["phase", "phase/sin", "phase/cos", "root_position/z"]
        for field, parts in LINK_COLUMNS.items():
            self.columns += columns(field, layout.link_names, parts)
        if options.deviation:
            away = "root_position-reference", "root_heading-reference"
            self.columns += [f"{away[0]}/x", f"{away[0]}/y", f"{away[1]}/sin", f"{away[1]}/cos"]
        self.shape = (len(self.columns),)

    def encode(
        self,
        phase: Tensor,
        root_position: Tensor,
        link_positions: Tensor,
        link_rotations: Tensor,
        link_linear_velocities: Tensor,
        link_angular_velocities: Tensor,
        root_heading: Tensor | None = None,
        reference_root_position: Tensor | None = None,
        reference_root_heading: Tensor | None = None,
    ) -> Tensor:
        angle = phase * (2 * math.pi)
        parts = [
            torch.stack([phase, angle.sin(), angle.cos(), root_position[:, 2]], dim=1),
            link_positions.flatten(1),
            link_rotations.flatten(1),
            link_linear_velocities.flatten(1),
            link_angular_velocities.flatten(1),
        ]
        if root_heading is not None:
            assert reference_root_position is not None
            assert reference_root_heading is not None
            away = (root_position - reference_root_position).unsqueeze(1)
            place = torch.bmm(away, turn_matrix(reference_root_heading))[:, 0, :2]
            turn = root_heading - reference_root_heading
            parts.append(torch.cat([place, torch.stack([turn.sin(), turn.cos()], dim=1)], dim=1))
        return torch.cat(parts, dim=1)
