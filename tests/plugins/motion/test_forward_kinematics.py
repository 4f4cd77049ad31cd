"""Forward kinematics against matrices multiplied one by one."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from motion_files import SKELETON, walker

from understudy.errors import FileError
from understudy_motion.clip import Skeleton
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_tensors import rotations


def test_positions_and_tips_are_products_of_matrices() -> None:
    rng = torch.Generator().manual_seed(1)
    clip = walker(frames=3)
    anyhow = torch.randn(3, 6, 4, generator=rng, dtype=torch.float64)
    clip = replace(clip, rotations=rotations.normalize(anyhow))
    positions, world = forward_kinematics(clip)
    tips = tip_positions(clip, positions, world)
    assert positions.shape == (3, 6, 3)
    assert world.shape == (3, 6, 4)
    for frame in range(3):
        frames: list[np.ndarray] = []
        for joint, parent in enumerate(SKELETON.parents):
            local = np.eye(4)
            local[:3, :3] = rotations.to_matrix(clip.rotations[frame, joint]).numpy()
            local[:3, 3] = SKELETON.offsets[joint] if joint else clip.root_position[frame].numpy()
            frames.append(local if parent < 0 else frames[parent] @ local)
            np.testing.assert_allclose(positions[frame, joint], frames[joint][:3, 3], atol=1e-12)
            turned = rotations.to_matrix(world[frame, joint])
            np.testing.assert_allclose(turned, frames[joint][:3, :3], atol=1e-12)
        for column, (name, tip) in enumerate(SKELETON.tips.items()):
            end = frames[SKELETON.joint_names.index(name)] @ [*tip, 1.0]
            np.testing.assert_allclose(tips[frame, column], end[:3], atol=1e-12)


def test_a_figure_is_needed() -> None:
    bare = replace(walker(), skeleton=None)
    with pytest.raises(FileError, match="has no skeleton"):
        forward_kinematics(bare)
    other = Skeleton(("a",), (-1,), np.zeros((1, 3)))
    with pytest.raises(FileError, match="joints are not the clip's"):
        forward_kinematics(replace(walker(), skeleton=other))


def test_without_tips() -> None:
    clip = walker()
    assert clip.skeleton is not None
    clip = replace(clip, skeleton=replace(clip.skeleton, tips={}))
    assert tip_positions(clip, *forward_kinematics(clip)).shape == (6, 0, 3)
