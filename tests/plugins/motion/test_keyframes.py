"""Clips of a few key frames."""

from __future__ import annotations

import pytest
import torch
from motion_files import walker

from understudy.errors import ConfigError
from understudy.options import make_options
from understudy_motion.clip import sample
from understudy_motion.keyframes import keyframed
from understudy_motion.section import MotionOptions
from understudy_tensors.rotations import angle_between, slerp


def test_key_frames_are_poses_of_the_clip_and_straight_in_between() -> None:
    walk = walker(31)
    clip = keyframed(walk, 4)
    assert clip.loop == walk.loop
    assert clip.num_frames == 4
    assert clip.duration == pytest.approx(walk.duration)
    position, rotation = sample(walk, clip.times[:3])
    torch.testing.assert_close(clip.root_position[:3], position)
    assert (clip.rotations[:3] * rotation).sum(-1).abs().min() > 1 - 1e-9
    middle = 0.5 * (clip.times[0] + clip.times[1]).reshape(1)
    place, between = sample(clip, middle)
    torch.testing.assert_close(place[0], 0.5 * (clip.root_position[0] + clip.root_position[1]))
    halves = slerp(clip.rotations[0], clip.rotations[1], torch.tensor(0.5, dtype=torch.float64))
    assert angle_between(between[0], halves).max() < 1e-6
    _, true = sample(walk, middle)
    assert angle_between(between, true).max() > 0.05, "and that is not how the legs swing"


def test_one_key_frame_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"motion\.keys=1"):
        make_options(MotionOptions, {"keys": 1}, "motion")
