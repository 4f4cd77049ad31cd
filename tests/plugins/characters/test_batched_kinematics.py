"""Kinematics of many poses at once, against MuJoCo's."""

from __future__ import annotations

import mujoco
import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from random_characters import random_model, random_poses

from understudy_characters.character import Character
from understudy_characters.kinematics import Kinematics, Poses
from understudy_tensors import rotations


@settings(max_examples=30, deadline=None)
@given(st.integers(0, 10_000))
def test_positions_and_rotations_are_mujocos(seed: int) -> None:
    character = Character("random", random_model(seed))
    qpos = random_poses(character.model, seed)
    poses = Kinematics(character).forward(qpos)
    data = mujoco.MjData(character.model)
    for frame, row in enumerate(qpos.numpy()):
        data.qpos[:] = row
        mujoco.mj_kinematics(character.model, data)
        for index, joint in enumerate(character.joints[1:], start=1):
            anchor = data.xanchor[character.model.body_jntadr[joint.body]]
            np.testing.assert_allclose(poses.positions[frame, index], anchor, atol=1e-9)
            rest = character.rest_rotations[index].as_matrix()
            turned = rotations.to_matrix(poses.rotations[frame, index]).numpy() @ rest
            np.testing.assert_allclose(turned, data.xmat[joint.body].reshape(3, 3), atol=1e-9)


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_hinges_of_one_body_apart(seed: int) -> None:
    """Bodies are where MuJoCo has them, and a pose survives the clip, whose joint is at the first hinge."""
    model = random_model(seed, apart=0.05)
    character, data = Character("random", model), mujoco.MjData(model)
    qpos = random_poses(model, seed)
    poses = Kinematics(character).forward(qpos)
    for frame, row in enumerate(qpos.numpy()):
        data.qpos[:] = row
        mujoco.mj_kinematics(model, data)
        for index, joint in enumerate(character.joints[1:], start=1):
            first = model.jnt_pos[model.body_jntadr[joint.body]]
            point = data.xpos[joint.body] + data.xmat[joint.body].reshape(3, 3) @ first
            np.testing.assert_allclose(poses.positions[frame, index], point, atol=1e-9)
    clip = character.clip(qpos, torch.arange(len(qpos)).double(), name="apart")
    again = character.clip(character.qpos(clip), clip.times, name="again")
    assert rotations.angle_between(again.rotations, clip.rotations).max() < 1e-6


@pytest.mark.parametrize("apart", [0.0, 0.05])
@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 10_000))
def test_a_step_turns_everything_below_about_its_axis(apart: float, seed: int) -> None:
    """Each degree of freedom by itself moves exactly what hangs on it, as its axis and pivot say."""
    character = Character("random", random_model(seed, apart))
    kinematics = Kinematics(character)
    qpos = random_poses(character.model, seed, count=1)
    here, tiny = kinematics.forward(qpos), 1e-6
    for dof, owner in enumerate(kinematics.owners.tolist()):
        step = torch.zeros(1, kinematics.num_dofs, dtype=torch.float64)
        step[0, 3 + dof] = tiny
        there = kinematics.forward(_without_limits(kinematics, qpos, here, step))
        moved = (there.positions - here.positions)[0] / tiny
        arm = here.positions[0] - here.pivots[0, dof]
        expected = torch.linalg.cross(here.axes[0, dof].expand_as(arm), arm)
        expected[~kinematics.hangs_on[:, owner]] = 0.0
        torch.testing.assert_close(moved, expected, atol=1e-5, rtol=0)


def _without_limits(
    kinematics: Kinematics, qpos: torch.Tensor, poses: Poses, step: torch.Tensor
) -> torch.Tensor:
    ranges = kinematics.hinge_ranges.clone()
    kinematics.hinge_ranges[:, 0], kinematics.hinge_ranges[:, 1] = -np.inf, np.inf
    moved = kinematics.moved(qpos, poses, step)
    kinematics.hinge_ranges[:] = ranges
    return moved


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_steps_respect_the_hinges_ranges(seed: int) -> None:
    character = Character("random", random_model(seed))
    kinematics = Kinematics(character)
    qpos = random_poses(character.model, seed)
    generator = torch.Generator().manual_seed(seed)
    step = torch.randn(len(qpos), kinematics.num_dofs, generator=generator, dtype=torch.float64)
    angles = kinematics.moved(qpos, kinematics.forward(qpos), step)[:, kinematics.hinge_addresses]
    assert (angles >= kinematics.hinge_ranges[:, 0] - 1e-12).all()
    assert (angles <= kinematics.hinge_ranges[:, 1] + 1e-12).all()


@settings(max_examples=20, deadline=None)
@given(st.integers(0, 10_000))
def test_aimed_at_rotations_it_can_have(seed: int) -> None:
    character = Character("random", random_model(seed))
    kinematics = Kinematics(character)
    qpos = random_poses(character.model, seed)
    poses = kinematics.forward(qpos)
    goals = dict(enumerate(poses.rotations.unbind(1)))
    found = kinematics.forward(kinematics.aimed(poses.positions[:, 0], goals))
    torch.testing.assert_close(found.positions, poses.positions, atol=1e-6, rtol=0)
    assert rotations.angle_between(found.rotations, poses.rotations).max() < 1e-6


def test_aimed_without_a_goal_is_the_zero_pose() -> None:
    character = Character("random", random_model(5))
    root = torch.tensor([[1.0, 0.0, 0.0, 0.0]], dtype=torch.float64)
    found = Kinematics(character).aimed(torch.zeros(1, 3, dtype=torch.float64), {0: root})
    at = character.root_address
    zero = torch.tensor(character.model.qpos0)
    zero[at : at + 7] = torch.tensor([0.0, 0, 0, 1, 0, 0, 0])
    expected = Kinematics(character).within_ranges(zero[None])
    torch.testing.assert_close(found, expected)
