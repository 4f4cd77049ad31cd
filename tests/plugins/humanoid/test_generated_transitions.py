"""The generated turns, sitting down and standing up."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
import pytest
import torch
from generated_motions import MODEL, Played

from understudy.errors import ConfigError
from understudy_humanoid.character import BODIES
from understudy_humanoid.clips import (
    generated_backflip,
    generated_cartwheel,
    generated_sit,
    generated_stand,
    generated_turn_left,
    generated_turn_right,
)
from understudy_humanoid.clips.sit import OVERLAP
from understudy_motion.clip import Clip, cycle_transform
from understudy_tensors import rotations

SEATS = [0.35, 0.4, 0.45, 0.5, 0.55]
THIGH = next(row for row in BODIES if row.name == "left_hip")


@pytest.mark.parametrize("angle", [0.3, math.pi / 2, 2.0, math.pi])
@pytest.mark.parametrize(("turn", "sign"), [(generated_turn_left, 1), (generated_turn_right, -1)])
def test_turns_turn_by_their_angle(turn: Callable[..., Clip], sign: int, angle: float) -> None:
    clip = turn(angle=angle, seconds=3.0)
    assert clip.duration == pytest.approx(3.0)
    transform = cycle_transform(clip)
    assert math.cos(transform.heading - sign * angle) == pytest.approx(1.0)
    heading = np.unwrap(rotations.heading(clip.rotations[:, 0]).numpy())
    assert heading[-1] - heading[0] == pytest.approx(sign * angle)
    # In place: the centre of mass stays within half a foot, and comes back.
    com = Played(clip).com
    assert np.abs(com[:, :2]).max() < 0.07
    assert np.abs(com[-1, :2]).max() < 1e-3


def test_turning_feet_take_turns_inside_foot_first() -> None:
    for turn, inside, outside in (
        (generated_turn_left, "left", "right"),
        (generated_turn_right, "right", "left"),
    ):
        motion = Played(turn(frame_rate=240.0))
        up = {side: motion.sole(side)[..., 2].min(axis=1) > 5e-3 for side in (inside, outside)}
        assert not (up["left"] & up["right"]).any()
        steps = {
            side: np.flatnonzero(np.diff(lifted.astype(int)) == 1) for side, lifted in up.items()
        }
        assert len(steps[inside]) == len(steps[outside]) == 2
        assert (steps[inside] < steps[outside]).all()


def test_turns_that_do_not_fit_their_time_are_refused() -> None:
    with pytest.raises(ConfigError, match="turn_left: angle=9"):
        generated_turn_left(angle=9.0)
    with pytest.raises(ConfigError, match="turn_right: seconds=1 is not possible for the 6 steps"):
        generated_turn_right(angle=math.pi, seconds=1.0)
    with pytest.raises(ConfigError, match="turn_right: seconds=30"):
        generated_turn_right(seconds=30.0)


def thigh_over_seat(motion: Played, frame: int, seat_height: float, edge: float) -> float:
    """How high, m, the left thigh's capsule is above the seat, where it is least."""
    body = MODEL.body("left_hip").id
    matrix = rotations.to_matrix(torch.from_numpy(motion.xquat[frame, body])).numpy()
    radius, half = THIGH.size
    along = np.linspace(-half, half, 50)[:, None] * [0.0, 0.0, 1.0] + THIGH.centre
    axis = motion.xpos[frame, body] + along @ matrix.T
    over = axis[:, 0] <= edge
    above = axis[over, 2] - radius - seat_height
    # Ahead of the edge what counts is the distance from the edge.
    ahead = np.hypot(axis[~over, 0] - edge, axis[~over, 2] - seat_height) - radius
    return float(np.concatenate([above, ahead]).min())


@pytest.mark.parametrize("seat_height", SEATS)
@pytest.mark.parametrize("make", [generated_sit, generated_stand])
def test_thighs_are_on_the_seat_and_never_in_it(
    make: Callable[..., Clip], seat_height: float
) -> None:
    motion = Played(make(seat_height=seat_height))
    frames = range(len(motion.times))
    seated = frames[-1] if make is generated_sit else 0
    edge = motion.qpos[seated, 0] + OVERLAP
    heights = [thigh_over_seat(motion, frame, seat_height, edge) for frame in frames]
    assert heights[seated] == pytest.approx(0.0, abs=2e-3)
    assert min(heights) > -0.005
    assert max(heights) > 0.15


@pytest.mark.parametrize("seat_height", SEATS)
@pytest.mark.parametrize("make", [generated_sit, generated_stand])
def test_centre_of_mass_is_over_the_feet_until_the_seat_bears(
    make: Callable[..., Clip], seat_height: float
) -> None:
    motion = Played(make(seat_height=seat_height))
    seated = motion.qpos[-1 if make is generated_sit else 0]
    free = np.abs(motion.qpos[:, :3] - seated[:3]).max(axis=1) > 1e-3
    heel, toe = motion.sole("left")[0, [0, 2], 0]
    assert free.mean() > 0.5
    assert (motion.com[free, 0] > heel + 0.01).all()
    assert (motion.com[free, 0] < toe - 0.01).all()
    assert np.abs(motion.com[:, 1]).max() < 1e-3


@pytest.mark.parametrize("make", [generated_sit, generated_stand])
def test_feet_stay_flat_where_they_are(make: Callable[..., Clip]) -> None:
    motion = Played(make())
    for side in ("left", "right"):
        sole = motion.sole(side)
        assert np.ptp(sole, axis=0).max() < 1e-6
        assert np.abs(sole[..., 2]).max() < 1e-6


def test_all_that_begins_or_ends_standing_stands_alike() -> None:
    stand = generated_stand()
    for clip in (
        generated_sit(),
        generated_turn_right(),
        generated_backflip(),
        generated_cartwheel(),
    ):
        assert (clip.root_position[0] - stand.root_position[-1]).abs().max() < 1e-4
        assert rotations.angle_between(clip.rotations[0], stand.rotations[-1]).max() < 1e-3


def test_impossible_chairs_are_refused() -> None:
    for make, name in ((generated_sit, "sit"), (generated_stand, "stand")):
        for seat_height in (0.2, 0.8, math.nan):
            with pytest.raises(ConfigError, match=f"{name}: seat_height="):
                make(seat_height=seat_height)
        with pytest.raises(ConfigError, match=f"{name}: seconds=0.1"):
            make(seconds=0.1)
