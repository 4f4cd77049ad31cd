"""The generated cartwheel and backflip: all the way round, on hands and feet, as bodies fall."""

from __future__ import annotations

import math
from collections.abc import Callable

import mujoco
import numpy as np
import pytest
from generated_motions import MODEL, Played

from understudy_humanoid.clips import generated_backflip, generated_cartwheel
from understudy_humanoid.clips.backflip import OFF, ON
from understudy_motion.clip import Clip, resample, sample
from understudy_motion.mirror import mirrored
from understudy_tensors import rotations


def turned(clip: Clip, axis: int) -> np.ndarray:
    """(F,) rad that the root has turned about a world axis, however often."""
    steps = rotations.to_exponential_map(
        rotations.multiply(clip.rotations[1:, 0], rotations.conjugate(clip.rotations[:-1, 0]))
    )
    return np.concatenate([[0.0], np.cumsum(steps[:, axis].numpy())])


def test_backflip_goes_once_backwards_round_and_ends_as_it_begins() -> None:
    clip = generated_backflip()
    assert turned(clip, 1)[-1] == pytest.approx(-2.0 * math.pi, abs=0.01)
    assert rotations.angle_between(clip.rotations[0], clip.rotations[-1]).max() < 1e-3
    moved = clip.root_position[-1] - clip.root_position[0]
    assert abs(moved[2]) < 1e-4
    assert -1.2 < moved[0] < -0.3
    motion = Played(clip)
    assert motion.com[:, 2].max() > motion.com[0, 2] + 0.2
    head = motion.xpos[:, MODEL.body("neck").id, 2]
    assert (head < motion.qpos[:, 2]).any()  # upside down


def test_backflip_keeps_its_angular_momentum_in_flight() -> None:
    clip = generated_backflip(frame_rate=480.0)
    motion = Played(clip)
    data, momentum = mujoco.MjData(MODEL), []
    step = motion.times[1]
    for before, now, after in zip(motion.qpos, motion.qpos[1:], motion.qpos[2:], strict=False):
        mujoco.mj_differentiatePos(MODEL, data.qvel, 2.0 * step, before, after)
        data.qpos[:] = now
        mujoco.mj_kinematics(MODEL, data)
        mujoco.mj_comPos(MODEL, data)
        mujoco.mj_comVel(MODEL, data)
        mujoco.mj_subtreeVel(MODEL, data)
        momentum.append(data.subtree_angmom[1].copy())
    times = motion.times[1:-1]
    flight = np.array(momentum)[(times > OFF + 0.01) & (times < ON - 0.01)]
    assert flight[:, 1].mean() < -20.0
    assert np.abs(flight - flight.mean(axis=0)).max() < 1.5


def test_cartwheel_turns_over_its_hands() -> None:
    clip = generated_cartwheel(frame_rate=240.0)
    tipped = turned(clip, 0)
    assert tipped[-1] == pytest.approx(-2.0 * math.pi, abs=0.01)
    motion = Played(clip)
    feet = np.minimum(*(motion.sole(s)[..., 2].min(axis=1) for s in ("left", "right"))) < 1e-3
    hands = np.stack([motion.hand(s)[:, 2] < 1e-3 for s in ("left", "right")])
    inverted = np.abs(tipped + math.pi) < 0.3
    assert not feet[inverted].any()
    assert hands[:, inverted].any(axis=0).all()
    assert (feet | hands.any(axis=0)).all()  # never in the air
    # One after the other: left foot leaves last and the left hand comes first.
    first, last = (np.flatnonzero(hands[side])[[0, -1]] for side in (0, 1))
    assert first[0] < last[0] < first[1] < last[1]
    assert motion.hand("right")[last[0], 1] - motion.hand("left")[first[0], 1] > 0.2
    moved = clip.root_position[-1] - clip.root_position[0]
    assert moved[1] > 2.0
    assert rotations.angle_between(clip.rotations[0], clip.rotations[-1]).max() < 1e-6


def test_cartwheel_to_the_right_is_the_mirror_image() -> None:
    right = generated_cartwheel(side="right")
    image = mirrored(generated_cartwheel())
    assert (right.root_position - image.root_position).abs().max() < 1e-12
    assert rotations.angle_between(right.rotations, image.rotations).max() < 1e-12
    assert turned(right, 0)[-1] == pytest.approx(2.0 * math.pi, abs=0.01)


@pytest.mark.parametrize(("make", "frames"), [(generated_backflip, 10), (generated_cartwheel, 11)])
def test_key_poses_are_few_and_go_the_same_way_round(
    make: Callable[..., Clip], frames: int
) -> None:
    dense, keys = make(frame_rate=480.0), make(key_poses=True, frame_rate=480.0)
    assert keys.num_frames == frames
    assert keys.duration == pytest.approx(dense.duration)
    position, rotation = sample(dense, keys.times)
    assert (keys.root_position - position).abs().max() < 1e-9
    assert rotations.angle_between(keys.rotations, rotation).max() < 1e-9
    axis = 1 if make is generated_backflip else 0
    assert turned(keys, axis)[-1] == pytest.approx(-2.0 * math.pi, abs=0.01)
    # Interpolated between so few poses, nothing stays where it was put.
    assert Played(resample(keys, 120.0)).clearance.min() < -0.005
