"""The generated run and hops: as fast, high and far as they say."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import pytest
import torch
from generated_motions import Played, resting

from understudy.errors import ConfigError
from understudy_humanoid.clips import generated_hop, generated_run
from understudy_motion.clip import cycle_transform, sample
from understudy_motion.mirror import mirrored
from understudy_tensors import rotations

GRAVITY = 9.81


@pytest.mark.parametrize("speed", [2.0, 3.0, 4.2, 5.0])
def test_run_is_as_fast_as_it_says(speed: float) -> None:
    clip = generated_run(speed=speed)
    transform = cycle_transform(clip)
    assert (transform.displacement[0] / clip.duration).item() == pytest.approx(speed)
    assert abs(transform.displacement[1]) < 1e-6
    motion = Played(clip)
    assert np.ptp(motion.com[:, 1]) < 1e-4
    assert 0.03 < np.ptp(motion.com[:, 2]) < 0.11  # the bounce of human running, m


def test_faster_runs_touch_the_floor_for_less_time_and_lift_the_knees() -> None:
    contact, lift = [], []
    for speed in (2.0, 3.0, 5.0):
        motion = Played(generated_run(speed=speed, frame_rate=240.0))
        assert len(resting(motion.sole("left")[:, 2])) == 1
        contact.append(motion.supported.mean() * motion.clip.duration)
        lift.append(np.ptp(motion.angle("left_hip")))
    assert contact[0] > contact[1] > contact[2]
    assert lift[0] < lift[1] < lift[2]


def test_run_lands_on_the_fore_foot_with_bent_knees_and_elbows() -> None:
    motion = Played(generated_run(frame_rate=240.0))
    sole = motion.sole("right")
    first = int(np.flatnonzero(sole[:, 2, 2] < 1e-3)[0])
    assert sole[first, 0, 2] > 0.01
    assert 0.35 < motion.angle("right_knee")[first] < 0.8
    for side in ("left", "right"):
        elbow = -motion.angle(f"{side}_elbow")
        assert 1.2 < elbow.min() < elbow.max() < 2.0


def test_run_repeats_mirrored_after_a_step() -> None:
    clip = generated_run()
    image = mirrored(clip)
    position, rotation = sample(clip, clip.times + 0.5 * clip.duration)
    assert rotations.angle_between(rotation, image.rotations).max() < 1e-3
    assert (position - image.root_position)[:, 1:].abs().max() < 1e-4


def test_key_poses_are_poses_of_the_run() -> None:
    run, keys = generated_run(frame_rate=480.0), generated_run(key_poses=True, frame_rate=480.0)
    assert keys.num_frames == 9
    assert keys.loop
    assert cycle_transform(keys).displacement[0] == pytest.approx(
        cycle_transform(run).displacement[0]
    )
    position, rotation = sample(run, keys.times)
    torch.testing.assert_close(keys.root_position, position)
    assert rotations.angle_between(keys.rotations, rotation).max() < 1e-9


@pytest.mark.parametrize("height", [0.05, 0.12, 0.3])
def test_hop_rises_as_high_as_it_says(height: float) -> None:
    motion = Played(generated_hop(height=height, frame_rate=480.0))
    off = int(np.flatnonzero(motion.clearance.min(axis=1) > 1e-5)[0])
    assert motion.com[:, 2].max() - motion.com[off, 2] == pytest.approx(height, abs=0.012)
    flight = (~motion.supported).mean() * motion.clip.duration
    assert flight == pytest.approx(2.0 * math.sqrt(2.0 * height / GRAVITY), abs=0.05)


@pytest.mark.parametrize("leg", ["both", "left", "right"])
@pytest.mark.parametrize("distance", [0.0, 0.6])
def test_hop_goes_as_far_as_it_says_on_the_leg_it_says(leg: Any, distance: float) -> None:
    clip = generated_hop(leg=leg, distance=distance, height=0.08)
    displacement = cycle_transform(clip).displacement
    assert displacement[0].item() == pytest.approx(distance, abs=1e-6)
    motion = Played(clip)
    for side in ("left", "right"):
        lowest = motion.sole(side)[..., 2].min()
        assert (lowest < 1e-3) == (leg in ("both", side))
        assert leg in ("both", side) or lowest > 0.03


def test_impossible_gaits_are_refused() -> None:
    for speed in (1.0, 6.0, math.nan):
        with pytest.raises(ConfigError, match="run: speed="):
            generated_run(speed=speed)
    for height in (0.0, 1.0):
        with pytest.raises(ConfigError, match="hop: height="):
            generated_hop(height=height)
    for distance in (-0.1, 2.0):
        with pytest.raises(ConfigError, match="hop: distance="):
            generated_hop(distance=distance)
