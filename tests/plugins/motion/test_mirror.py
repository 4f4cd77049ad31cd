"""Mirror images: an involution, left for right, and the walk half a cycle later."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st

from understudy.errors import FileError
from understudy_humanoid.clips import generated_turn_left, generated_turn_right, generated_walk
from understudy_motion.clip import Clip, Skeleton, cycle_transform, sample
from understudy_motion.mirror import mirrored
from understudy_tensors import rotations

NAMES = ("hips", "spine", "left_arm", "right_arm", "LeftLeg", "RightLeg", "lfoot", "rfoot")
PARENTS = (-1, 0, 1, 1, 0, 0, 4, 5)


def figure(seed: int) -> Clip:
    """Any motion of a figure whose sides differ in nothing but their names."""
    generator = torch.Generator().manual_seed(seed)
    draw = torch.randn(5, len(NAMES), 4, generator=generator, dtype=torch.float64)
    half = np.random.default_rng(seed).normal(size=(len(NAMES), 3))
    half[[3, 5, 7]] = half[[2, 4, 6]] * [1.0, -1.0, 1.0]
    half[[0, 1], 1] = 0.0
    half[0] = 0.0
    return Clip(
        name="any",
        times=torch.arange(5.0),
        root_position=torch.randn(5, 3, generator=generator, dtype=torch.float64),
        rotations=rotations.normalize(draw),
        joint_names=NAMES,
        loop=False,
        skeleton=Skeleton(
            NAMES, PARENTS, half, {"lfoot": np.array([0.1, 0.02, 0.0]), "spine": np.ones(3)}
        ),
    )


@settings(deadline=None)
@given(st.integers(0, 2**31))
def test_twice_mirrored_is_the_same(seed: int) -> None:
    clip = figure(seed)
    again = mirrored(mirrored(clip))
    assert torch.equal(again.root_position, clip.root_position)
    torch.testing.assert_close(again.rotations, clip.rotations, atol=1e-14, rtol=0.0)
    assert again.skeleton is not None
    assert clip.skeleton is not None
    assert np.array_equal(again.skeleton.offsets, clip.skeleton.offsets)
    assert again.skeleton.parents == clip.skeleton.parents
    assert {k: v.tolist() for k, v in again.skeleton.tips.items()} == {
        k: v.tolist() for k, v in clip.skeleton.tips.items()
    }
    assert (again.name, again.loop, again.source) == (clip.name, clip.loop, clip.source)


@settings(deadline=None)
@given(st.integers(0, 2**31))
def test_joints_are_where_the_mirror_shows_them(seed: int) -> None:
    clip, image = figure(seed), mirrored(figure(seed))
    flip = torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64)
    partner = [0, 1, 3, 2, 5, 4, 7, 6]
    torch.testing.assert_close(places(image), places(clip)[partner] * flip)


def places(clip: Clip) -> torch.Tensor:
    """(J, F, 3) m, world, by the skeleton."""
    assert clip.skeleton is not None
    turned, found = [], []
    for joint, parent in enumerate(PARENTS):
        local = clip.rotations[:, joint]
        if parent < 0:
            turned.append(local)
            found.append(clip.root_position)
            continue
        offset = torch.from_numpy(clip.skeleton.offsets[joint])
        found.append(found[parent] + rotations.rotate(turned[parent], offset))
        turned.append(rotations.multiply(turned[parent], local))
    return torch.stack(found)


def test_mirrored_walk_is_the_walk_half_a_cycle_later() -> None:
    walk = generated_walk()
    image = mirrored(walk)
    position, rotation = sample(walk, walk.times + 0.5 * walk.duration)
    half = 0.5 * cycle_transform(walk).displacement[0]
    moved = position - torch.tensor([half, 0.0, 0.0], dtype=torch.float64)
    assert (moved - image.root_position).abs().max() < 1e-6
    assert rotations.angle_between(rotation, image.rotations).max() < 1e-5


def test_mirrored_turn_left_is_the_turn_right() -> None:
    left, right = mirrored(generated_turn_left()), generated_turn_right()
    assert (left.root_position - right.root_position).abs().max() < 1e-6
    assert rotations.angle_between(left.rotations, right.rotations).max() < 1e-6
    assert cycle_transform(left).heading == pytest.approx(-torch.pi / 2)


def test_figures_without_an_image_are_refused() -> None:
    clip = figure(0)
    names = (*NAMES[:-1], "tail")
    one_armed = replace(clip, joint_names=(*NAMES[:3], "arm", *NAMES[4:]), skeleton=None)
    with pytest.raises(FileError, match="'left_arm' has no counterpart 'right_arm'"):
        mirrored(one_armed)
    assert mirrored(replace(clip, joint_names=names, skeleton=None)).joint_names == names
    skeleton = Skeleton(NAMES, (-1, 0, 1, 0, 0, 0, 4, 5), np.zeros((8, 3)))
    with pytest.raises(FileError, match="hang on different parts"):
        mirrored(replace(clip, skeleton=skeleton))
