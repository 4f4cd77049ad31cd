"""What figures look like: geoms at their places, bones from joint to joint."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest

from understudy_characters.character import Character
from understudy_characters.shapes import bones, shapes
from understudy_humanoid.character import build_humanoid
from understudy_humanoid.clips import generated_walk


def test_bones_reach_from_joint_to_joint() -> None:
    skeleton = generated_walk().skeleton
    assert skeleton is not None
    drawn = list(bones(skeleton))
    names, offsets = skeleton.joint_names, skeleton.offsets
    assert {shape.joint for shape in drawn} == set(names)
    knee = offsets[names.index("right_knee")]
    (thigh,) = (shape for shape in drawn if shape.joint == "right_hip")
    along = thigh.vertices @ knee / np.linalg.norm(knee)
    assert along.min() == pytest.approx(0.0, abs=1e-9)
    assert along.max() == pytest.approx(np.linalg.norm(knee))


def test_shapes_bound_the_geoms_in_the_zero_pose() -> None:
    """The lowest vertices lie where MuJoCo has the soles; trunk and limbs are all there."""
    character = Character("humanoid", build_humanoid().compile())
    drawn = shapes(character)
    assert len(drawn) == len(character.shown) > len(character.geoms)
    rows = {name: row for row, name in enumerate(character.joint_names)}
    world = [s.vertices + character.rest_positions[rows[s.joint]] for s in drawn]
    data = mujoco.MjData(character.model)
    mujoco.mj_kinematics(character.model, data)
    lowest = min(part[:, 2].min() for part in world) + data.xpos[character.root, 2]
    assert lowest == pytest.approx(0.0, abs=1e-6)
