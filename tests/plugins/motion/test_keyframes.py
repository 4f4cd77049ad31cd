"""Clips of a few key frames."""

from __future__ import annotations

import pytest
import torch

from understudy.errors import ConfigError
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_motion.clip import Clip, sample
from understudy_motion.keyframes import keyframed


def test_key_frames_are_poses_of_the_clip_and_straight_in_between(plugins: Plugins) -> None:
    walk: Clip = plugins.registry.find("clip", "walk").factory()
    clip = keyframed(walk, 4)
    assert clip.loop == walk.loop
    assert clip.num_frames == 4
    assert clip.duration == pytest.approx(walk.duration)
    position, rotation = sample(walk, clip.times[:3])
    torch.testing.assert_close(clip.root_position[:3], position)
    assert (clip.rotations[:3] * rotation).sum(-1).abs().min() > 1 - 1e-9
    middle = 0.5 * (clip.times[1] + clip.times[2]).reshape(1)
    between, _ = sample(clip, middle)
    torch.testing.assert_close(between[0], 0.5 * (clip.root_position[1] + clip.root_position[2]))
    true, _ = sample(walk, middle)
    assert (between - true).norm() > 1e-3, "and that is not how the walk goes"


def test_one_key_frame_is_refused() -> None:
    with pytest.raises(ConfigError, match=r"motion\.keys=1"):
        load_experiment(["experiment=spacetime/walk", "motion.keys=1"])
