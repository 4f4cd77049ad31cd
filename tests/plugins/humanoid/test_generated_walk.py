"""The generated walk: symmetric, planted, closed, within a human's range, straight or on an arc."""

from __future__ import annotations

import math

import numpy as np
import pytest
import torch
from generated_motions import Played, resting

from understudy.errors import ConfigError
from understudy_humanoid.clips import generated_walk
from understudy_humanoid.clips.walk import TOE_OFF
from understudy_motion.clip import Clip, cycle_transform, sample
from understudy_motion.mirror import mirrored
from understudy_tensors import rotations

WALKS = [(1.2, 1.05), (0.8, 1.2), (1.5, 0.95)]


@pytest.fixture(params=WALKS, ids=lambda walk: f"{walk[0]} m/s")
def walk(request: pytest.FixtureRequest) -> Clip:
    speed, cycle = request.param
    return generated_walk(speed=speed, cycle=cycle)


def test_cycle_goes_straight_ahead(walk: Clip, request: pytest.FixtureRequest) -> None:
    transform = cycle_transform(walk)
    speed, cycle = request.node.callspec.params["walk"]
    assert walk.duration == pytest.approx(cycle)
    assert transform.displacement[0].item() == pytest.approx(speed * cycle)
    assert abs(transform.displacement[1]) < 1e-9
    assert abs(transform.heading) < 1e-9


def test_second_half_mirrors_the_first(walk: Clip) -> None:
    image = mirrored(walk)
    position, rotation = sample(walk, walk.times + 0.5 * walk.duration)
    assert rotations.angle_between(rotation, image.rotations).max() < 1e-5
    moved = position - image.root_position
    assert (moved[:, 0] - moved[0, 0]).abs().max() < 1e-6
    assert moved[:, 1:].abs().max() < 1e-6


def test_every_stance_lasts_as_long_as_it_should(walk: Clip) -> None:
    motion = Played(walk)
    frames = walk.num_frames - 1
    heel = motion.sole("right")[:, 0]
    toe = motion.sole("right")[:, 2]
    assert [round(s.stop / frames, 1) for s in resting(toe)] == [TOE_OFF]
    assert resting(heel)[0].start == 0
    swing = motion.sole("right")[int(0.7 * frames) : int(0.92 * frames)]
    assert 0.01 < swing[..., 2].min(axis=1).min() < 0.05  # the foot is lifted, and not too high


def test_knees_and_elbows_bend_the_human_way(walk: Clip) -> None:
    motion = Played(walk)
    for side in ("left", "right"):
        knee, elbow = motion.angle(f"{side}_knee"), -motion.angle(f"{side}_elbow")
        assert 0.1 < knee.min() < 0.6
        assert 0.8 < knee.max() < 1.4
        assert 0.0 < elbow.min() < elbow.max() < 1.0


@pytest.mark.parametrize("rate", [-0.8, 0.4, 1.0])
def test_an_arc_turns_as_fast_as_it_should(rate: float) -> None:
    speed, cycle = 1.2, 1.05
    clip = generated_walk(speed=speed, cycle=cycle, heading_rate=rate)
    transform = cycle_transform(clip)
    assert transform.heading == pytest.approx(rate * cycle)
    # After many cycles the root is on a circle, whose length per cycle is about the stride.
    position = sample(clip, torch.arange(12) * cycle)[0].numpy()
    centre = np.linalg.lstsq(
        np.column_stack([2 * position[:, :2], np.ones(12)]),
        (position[:, :2] ** 2).sum(axis=1),
        rcond=None,
    )[0][:2]
    radii = np.linalg.norm(position[:, :2] - centre, axis=1)
    assert np.ptp(radii) < 1e-6
    assert radii[0] == pytest.approx(speed / abs(rate), abs=0.12)  # the body leans into the arc
    assert math.copysign(1.0, centre[1]) == math.copysign(1.0, rate)


def test_an_arc_to_the_left_is_the_mirror_image_of_one_to_the_right() -> None:
    left = mirrored(generated_walk(heading_rate=0.6))
    position, rotation = sample(generated_walk(heading_rate=-0.6), left.times + 0.5 * left.duration)
    turn = torch.tensor(-0.5 * 0.6 * left.duration)
    back = rotations.from_heading(-turn.double())
    root = rotations.multiply(back, rotation[:, 0])
    assert rotations.angle_between(root, left.rotations[:, 0]).max() < 1e-5
    assert rotations.angle_between(rotation[:, 1:], left.rotations[:, 1:]).max() < 1e-5
    assert (position[:, 2] - left.root_position[:, 2]).abs().max() < 1e-6


def test_impossible_walks_are_refused() -> None:
    with pytest.raises(ConfigError, match=r"cycle=1.05.*too long for the legs"):
        generated_walk(speed=2.9)
    for name, value in (("cycle", 0.0), ("cycle", math.nan), ("speed", -1.0), ("speed", 9.0)):
        with pytest.raises(ConfigError, match=f"walk: {name}="):
            generated_walk(**{name: value})
    with pytest.raises(ConfigError, match="walk: heading_rate=2"):
        generated_walk(heading_rate=2.0)
    with pytest.raises(ConfigError, match=r"heading_rate=1 is not possible at speed=0\.3"):
        generated_walk(speed=0.3, heading_rate=1.0)


def test_each_caller_has_a_clip_of_its_own() -> None:
    """It is made once; what one does to it no other sees."""
    first, again = generated_walk(speed=0.9), generated_walk(speed=0.9)
    first.rotations.zero_()
    assert first is not again
    assert torch.equal(generated_walk(speed=0.9).rotations, again.rotations)
    assert again.rotations.abs().sum() > 1.0
