"""The frame of comparison: invariant to direction, continuous through flips."""

from __future__ import annotations

import math

import torch

from understudy.task import Context
from understudy_characters.scene import CharacterScene
from understudy_spacetime.alignment import Alignment
from understudy_tensors.rotations import (
    from_axis_angle,
    from_heading,
    heading,
    inverse_rotate,
    multiply,
)

CONTEXT = Context(
    0,
    torch.device("cpu"),
    1,
    control_dt=1 / 30,
    substeps=20,
    scene=CharacterScene(CharacterScene.Options("humanoid")),
)
HANDS = torch.tensor([[0.1, 0.4, 0.5], [0.1, -0.4, 0.5], [0.0, 0.1, -0.8], [0.0, -0.1, -0.8]])


def compute(root: torch.Tensor, reference: torch.Tensor) -> dict[str, torch.Tensor]:
    """The fields for bodies whose end-effectors are rigidly attached to the root."""

    def local(q: torch.Tensor) -> torch.Tensor:
        world = inverse_rotate(torch.tensor([1.0, 0.0, 0.0, 0.0]), HANDS)
        turned = torch.stack([_rotate(r, world) for r in q])
        return torch.stack(
            [_rotate(from_heading(-heading(r)), v) for r, v in zip(q, turned, strict=True)]
        )

    given = Alignment(None, CONTEXT).compute(
        root, heading(root), reference, heading(reference), local(root)
    )
    return {**given, "reference": local(reference)}


def _rotate(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    from understudy_tensors.rotations import rotate

    return rotate(q.expand(len(v), 4), v)


def pitch(angles: torch.Tensor) -> torch.Tensor:
    return from_axis_angle(torch.tensor([0.0, 1.0, 0.0]), angles)


def test_a_turn_about_the_vertical_is_no_difference() -> None:
    reference = pitch(torch.linspace(-1.0, 1.0, 9))
    root = multiply(from_heading(torch.full((9,), 0.6)), reference)
    found = compute(root, reference)
    torch.testing.assert_close(found["heading_deviation"], torch.full((9,), 0.6))
    torch.testing.assert_close(
        found["aligned_end_effector_positions"], found["reference"], atol=1e-5, rtol=0
    )


def test_being_a_little_late_in_a_backflip_stays_a_little_difference() -> None:
    """5 degrees behind at every moment of a whole turn: hands within 0.1 m, never on the other side."""
    angles = torch.linspace(0.0, -2 * math.pi, 361)
    found = compute(pitch(angles + math.radians(5)), pitch(angles))
    apart = (found["aligned_end_effector_positions"] - found["reference"]).norm(dim=2).amax(dim=1)
    # while x points up or down the reference's own heading is arbitrary, but the same for both
    assert apart.max() < 0.1
