"""Observations of section 3.4.1: the character's state with the phase, and the reference pose."""

from __future__ import annotations

import math

import torch
from torch import Tensor

from understudy.task import Context, Encoder, Shape
from understudy_characters.layout import LINK_COLUMNS, XYZ, columns
from understudy_characters.scene import CharacterScene
from understudy_tensors.rotations import turned


class StateEncoder(Encoder):
    """Link poses and velocities, end-effectors, phase, and the root's state.

    Links and end-effectors are relative to the root, in the direction-invariant frame of
    :mod:`understudy_spacetime.alignment`.

    The paper gives the root in the world frame. A character that walks away would leave every
    observed range, so its position and heading stand here relative to the reference's, in the
    reference's heading frame: the same information, bounded. Rotations are two axes (6 numbers)
    rather than quaternions, which jump in sign.

    Columns, for L links and E end-effectors, each in the order of the character's: the phase, its
    sine and cosine; the root's height in m; sine and cosine of its turn from the reference's; the
    root's position less the reference's (3), m; then the links' positions (3 L, m), x and z axes
    (6 L), linear velocities (3 L, m/s) and angular velocities (3 L, rad/s); the end-effectors'
    positions (3 E, m).
    """

    reads = (
        "phase", "root_position", "reference_root_position", "reference_root_heading",
        "heading_deviation", "frame_turn", "aligned_end_effector_positions",
        "link_positions", "link_rotations", "link_linear_velocities", "link_angular_velocities",
    )  # fmt: skip
    shape: Shape

    def __init__(self, options: None, context: Context) -> None:
        layout = context.need_scene(CharacterScene, "encoder 'spacetime/state'").layout
        self.columns = (
            "phase", "phase/sin", "phase/cos", "root_position/z", "heading_deviation/sin", "heading_deviation/cos",
            *(f"root_position-reference/{axis}" for axis in XYZ),
            *(c for field, parts in LINK_COLUMNS.items() for c in columns(field, layout.link_names, parts)),
            *columns("aligned_end_effector_positions", layout.end_effectors),
        )  # fmt: skip
        self.shape = (len(self.columns),)

    def encode(
        self,
        phase: Tensor,
        root_position: Tensor,
        reference_root_position: Tensor,
        reference_root_heading: Tensor,
        heading_deviation: Tensor,
        frame_turn: Tensor,
        aligned_end_effector_positions: Tensor,
        **links: Tensor,
    ) -> Tensor:
        away = (root_position - reference_root_position).unsqueeze(1)
        error = turned(away, -reference_root_heading).squeeze(1)
        vectors = torch.cat([v.reshape(len(v), -1, 3) for v in links.values()], dim=1)
        turn = heading_deviation
        angle = phase * (2 * math.pi)
        scalars = [phase, angle.sin(), angle.cos(), root_position[:, 2], turn.sin(), turn.cos()]
        return torch.cat(
            [
                torch.stack(scalars, dim=1),
                error,
                turned(vectors, frame_turn).flatten(1),
                aligned_end_effector_positions.flatten(1),
            ],
            dim=1,
        )


class FeedforwardEncoder(Encoder):
    """The reference's joint targets, (N, A): what the feedforward controller looks up."""

    reads = ("reference_joint_targets",)

    def __init__(self, options: None, context: Context) -> None:
        model = context.need_scene(CharacterScene, "encoder 'spacetime/feedforward'").model
        names = [model.actuator(k).name or str(k) for k in range(model.nu)]
        self.columns = [f"reference_joint_targets/{name}" for name in names]
        self.shape: Shape = (model.nu,)

    def encode(self, reference_joint_targets: Tensor) -> Tensor:
        return reference_joint_targets
