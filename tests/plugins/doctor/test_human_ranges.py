"""Human ranges of ball joints, in poses that people can and cannot take."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from understudy_characters.character import Character
from understudy_doctor.ranges import MARGIN, beyond, range_of
from understudy_tensors import rotations

X, Y, Z = (1.0, 0.0, 0.0), (0.0, 1.0, 0.0), (0.0, 0.0, 1.0)


def excess(
    character: Character, joint: str, axis: tuple[float, float, float], degrees: float
) -> float:
    """Degrees beyond the range and its margin, turned so from the zero pose."""
    row = character.joint_names.index(joint)
    entry = range_of(character, row)
    assert entry is not None
    angle = torch.tensor([np.radians(degrees)])
    turn = rotations.from_axis_angle(torch.tensor(axis, dtype=torch.float64), angle)
    return float(np.degrees(beyond(character, row, turn, entry)[0]))


def test_the_table_applies_to_the_humanoid(humanoid: Character) -> None:
    balls = [joint.name for joint in humanoid.joints[1:] if len(joint.axes) == 0]
    rows = [humanoid.joint_names.index(name) for name in balls]
    assert all(range_of(humanoid, row) is not None for row in rows)
    assert range_of(humanoid, humanoid.joint_names.index("left_knee")) is None


@pytest.mark.parametrize(
    ("joint", "axis", "degrees"),
    [
        ("left_hip", Y, -110.0),  # the knee to the chest
        ("right_hip", Y, -110.0),
        ("left_hip", X, 50.0),  # legs apart
        ("right_hip", X, -50.0),
        ("left_shoulder", Y, -178.0),  # arms up, by the front
        ("left_shoulder", X, 178.0),  # and by the side
        ("right_shoulder", X, -178.0),
        ("left_shoulder", Y, 165.0),  # the same place, taken for backwards
        ("chest", Y, 90.0),  # bowing
        ("left_ankle", Y, 60.0),  # on tiptoe
        ("neck", Z, 70.0),
    ],
)
def test_what_people_do(
    humanoid: Character, joint: str, axis: tuple[float, float, float], degrees: float
) -> None:
    assert excess(humanoid, joint, axis, degrees) == 0.0


@pytest.mark.parametrize(
    ("joint", "axis", "degrees", "limit"),
    [
        ("left_hip", Y, 90.0, 30.0),  # the leg far back
        ("left_hip", X, -80.0, 30.0),  # through the other one
        ("right_hip", X, 80.0, 30.0),
        ("left_shoulder", Y, 110.0, 60.0),
        ("chest", Y, -75.0, 25.0),
        ("left_ankle", Y, -70.0, 20.0),
        ("neck", Z, 120.0, 60.0),
        ("neck", Z, -120.0, 60.0),
    ],
)
def test_what_people_do_not(
    humanoid: Character, joint: str, axis: tuple[float, float, float], degrees: float, limit: float
) -> None:
    expected = abs(degrees) - limit - np.degrees(MARGIN)
    assert excess(humanoid, joint, axis, degrees) == pytest.approx(expected, abs=1e-6)


def test_both_sides_are_mirror_images(humanoid: Character) -> None:
    rng = np.random.default_rng(0)
    vectors = torch.from_numpy(rng.normal(size=(50, 3)))
    mirrored = vectors * torch.tensor([-1.0, 1.0, -1.0])
    over = []
    for joint, turned in (("left_hip", vectors), ("right_hip", mirrored)):
        row = humanoid.joint_names.index(joint)
        entry = range_of(humanoid, row)
        assert entry is not None
        over.append(beyond(humanoid, row, rotations.from_exponential_map(turned), entry))
    np.testing.assert_allclose(over[0], over[1], atol=1e-9)
    assert (over[0] > 0).any()
    assert (over[0] == 0).any()
