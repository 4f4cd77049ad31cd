"""Laws of clips: checking, interpolation, loops that carry on, velocities."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch import Tensor

from understudy.errors import FileError
from understudy_motion.clip import (
    Clip,
    CycleTransform,
    cycle_transform,
    resample,
    sample,
    velocities,
)
from understudy_tensors import rotations

CASES = settings(max_examples=30, deadline=None)
F64 = torch.float64


def arc_clip(turn: float = 0.7, frames: int = 61, loop: bool = True) -> Clip:
    """A root that drives an arc of `turn` radians in 2 s, and a joint that swings once."""
    times = torch.linspace(0.0, 2.0, frames, dtype=F64)
    yaw = turn * times / 2.0
    radius = 3.0 / turn
    position = torch.stack(
        (radius * yaw.sin(), radius * (1 - yaw.cos()), 1.0 + 0.1 * torch.sin(math.pi * times)), -1
    )
    swing = torch.sin(math.pi * times)[:, None] * torch.tensor([0.0, 0.5, 0.0], dtype=F64)
    pose = torch.stack((rotations.from_heading(yaw), rotations.from_exponential_map(swing)), 1)
    return Clip("arc", times, position, pose, ("root", "joint"), loop)


def close(a: Tensor, b: Tensor, tolerance: float = 1e-9) -> bool:
    return bool((a - b).abs().max() < tolerance)


def test_sampling_at_the_frames_returns_them() -> None:
    clip = arc_clip(loop=False)
    position, pose = sample(clip, clip.times)
    assert close(position, clip.root_position)
    assert rotations.angle_between(pose, clip.rotations).max() < 1e-9


@CASES
@given(st.floats(-20.0, 20.0), st.sampled_from([0.7, -2.0, 1e-4]))
def test_a_looping_arc_stays_on_its_circle(time: float, turn: float) -> None:
    position, pose = sample(arc_clip(turn, frames=601), torch.tensor([time]))
    yaw = turn * time / 2.0
    radius = 3.0 / turn
    expected = torch.tensor([radius * math.sin(yaw), radius * (1 - math.cos(yaw))], dtype=F64)
    assert close(position[0, :2], expected, 1e-4)
    up = torch.tensor(yaw, dtype=F64)
    assert rotations.angle_between(pose[0, 0], rotations.from_heading(up)) < 1e-6
    assert abs(position[0, 2].item() - 1.0 - 0.1 * math.sin(math.pi * time)) < 1e-4


def test_cycle_powers_are_repeated_application() -> None:
    transform = CycleTransform(torch.tensor([1.0, 0.3], dtype=F64), 0.4)
    point, turn = torch.zeros(3, dtype=F64), rotations.from_heading(torch.tensor(0.4, dtype=F64))
    for cycles in range(6):
        displacement, heading = transform.power(torch.tensor([float(cycles)], dtype=F64))
        assert close(displacement[0], point[:2])
        assert heading.item() == pytest.approx(0.4 * cycles)
        point = rotations.rotate(turn, point) + torch.tensor([1.0, 0.3, 0.0], dtype=F64)
    straight = CycleTransform(torch.tensor([1.0, 0.3], dtype=F64), 0.0)
    assert close(straight.power(torch.tensor([-3.0]))[0], torch.tensor([[-3.0, -0.9]]), 1e-6)


def test_a_clip_that_does_not_loop_is_held_at_its_ends() -> None:
    clip = arc_clip(loop=False)
    position, _ = sample(clip, torch.tensor([-1.0, 99.0]))
    assert close(position, clip.root_position[[0, -1]])


def test_velocities_match_the_motion_also_across_the_seam() -> None:
    linear, angular = velocities(arc_clip(frames=601))
    assert close(torch.linalg.vector_norm(linear[:, :2], dim=-1), torch.full((601,), 1.5), 1e-3)
    assert close(angular[:, 0], torch.tensor([0.0, 0.0, 0.35], dtype=F64).expand(601, 3), 1e-9)
    swing = 0.5 * math.pi * torch.cos(math.pi * torch.linspace(0, 2, 601, dtype=F64))
    assert close(angular[:, 1, 1], swing, 1e-3)


def test_resampling_keeps_the_motion_and_the_loop() -> None:
    clip = arc_clip(frames=601)
    denser = resample(clip, 97.0)
    assert denser.num_frames == 195
    assert denser.duration == clip.duration
    assert cycle_transform(denser).heading == pytest.approx(0.7)
    times = torch.linspace(-3.0, 9.0, 50)
    assert close(sample(denser, times)[0], sample(clip, times)[0], 1e-3)


def test_signs_are_aligned_and_norms_made_one() -> None:
    clip = arc_clip()
    flipped = clip.rotations.clone()
    flipped[::2] *= -1.004
    repaired = replace(clip, rotations=flipped).rotations
    assert close(repaired, clip.rotations)


@pytest.mark.parametrize(
    ("field", "frame", "value", "message"),
    [
        ("times", 5, math.nan, "frame 5: time is not a finite"),
        ("times", 5, 0.0, "frame 5: time does not increase"),
        ("times", 0, -1.0, "time of frame 0"),
        ("root_position", 7, math.inf, "frame 7: root position is not finite"),
        ("root_position", 7, 1e300, "frame 7: root position is more than"),
        ("rotations", 60, math.nan, "frame 60: a rotation is not finite"),
        ("rotations", 3, 0.0, "frame 3: root quaternion is not unit"),
    ],
)
def test_damage_is_named(field: str, frame: int, value: float, message: str) -> None:
    clip = arc_clip()
    damaged = getattr(clip, field).clone()
    damaged[frame] = value
    with pytest.raises(FileError, match=message):
        replace(clip, **{field: damaged})


def test_other_nonsense_is_refused() -> None:
    clip = arc_clip()
    with pytest.raises(FileError, match="named twice"):
        replace(clip, joint_names=("a", "a"))
    with pytest.raises(FileError, match="do not describe"):
        replace(clip, joint_names=("a",))
    with pytest.raises(FileError, match="at least 2 frames"):
        Clip("one", torch.zeros(1), torch.zeros(1, 3), torch.ones(1, 1, 4) / 2, ("a",), False)
