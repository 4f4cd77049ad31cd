"""The direction-invariant frame in which character and reference are compared (section 3.5.1).

The heading of a flipping body is not continuous: where its x axis points straight up or down, the
yaw of that axis jumps by half a turn, and a character half a frame behind its reference would seem
to have its hands and feet on the wrong sides. The *rotation from the reference to the character* is
small as long as the root stays within its bound, so its turn about the vertical is well defined
always. The character's frame is therefore the reference's heading turned by that deviation.
"""

from __future__ import annotations

from collections.abc import Mapping

import torch
from torch import Tensor

from understudy.task import Context, Fields, Shape
from understudy_characters.scene import CharacterScene
from understudy_tensors.rotations import canonical, conjugate, multiply, turned


class Alignment(Fields):
    """How the character is turned from its reference, and its end-effectors in the common frame.

    ``heading_deviation`` (N,) rad is the turn about the vertical of the rotation from the
    reference's root to the character's; ``frame_turn`` (N,) rad turns vectors of the character's
    heading frame into the common one.
    """

    reads = (
        "root_rotation", "root_heading", "reference_root_rotation", "reference_root_heading",
        "end_effector_positions",
    )  # fmt: skip
    provides: Mapping[str, Shape] = {
        "heading_deviation": (),
        "frame_turn": (),
        "aligned_end_effector_positions": (0, 3),  # the instance's have the character's number
    }

    def __init__(self, options: None, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "fields 'spacetime/alignment'").layout
        count = len(layout.end_effectors)
        self.provides = {**self.provides, "aligned_end_effector_positions": (count, 3)}

    def compute(
        self,
        root_rotation: Tensor,
        root_heading: Tensor,
        reference_root_rotation: Tensor,
        reference_root_heading: Tensor,
        end_effector_positions: Tensor,
    ) -> Mapping[str, Tensor]:
        away = canonical(multiply(root_rotation, conjugate(reference_root_rotation)))
        deviation = 2.0 * torch.atan2(away[:, 3], away[:, 0])
        turn = root_heading - reference_root_heading - deviation
        return {
            "heading_deviation": deviation,
            "frame_turn": turn,
            "aligned_end_effector_positions": turned(end_effector_positions, turn),
        }
