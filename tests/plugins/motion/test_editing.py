"""Edits of clips: laws they keep, on made motions."""

from __future__ import annotations

import math
from dataclasses import replace

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from motion_files import SKELETON, walker
from torch import Tensor

from understudy.errors import ConfigError, FileError
from understudy_motion import editing
from understudy_motion.clip import Clip, cycle_transform, sample, velocities
from understudy_motion.kinematics import forward_kinematics
from understudy_tensors import rotations

RATE = 30.0
J = len(SKELETON.joint_names)


def stepping(
    seconds: float = 4.0, period: float = 1.0, rate: float = RATE, turning: float = 0.0
) -> Clip:
    """A gait at 1.2 m/s of exactly this period, that turns by `turning` rad/s; not looping."""
    times = torch.arange(round(seconds * rate) + 1, dtype=torch.float64) / rate
    phase = 2.0 * math.pi * times / period
    heading = turning * times
    vectors = torch.zeros(len(times), J, 3, dtype=torch.float64)
    vectors[:, 1, 2] = 0.1 * torch.sin(phase)
    vectors[:, 2, 1], vectors[:, 4, 1] = 0.4 * torch.sin(phase), -0.4 * torch.sin(phase)
    vectors[:, 3, 1] = 0.4 + 0.4 * torch.cos(phase)
    vectors[:, 5, 1] = 0.4 - 0.4 * torch.cos(phase)
    turned = rotations.from_exponential_map(vectors)
    turned[:, 0] = rotations.from_heading(heading)
    place = torch.zeros(len(times), 3, dtype=torch.float64)
    place[:, 0] = 1.2 * times
    if abs(turning) > 1e-6:
        radius = 1.2 / turning
        place[:, 0], place[:, 1] = radius * heading.sin(), radius * (1.0 - heading.cos())
    place[:, 2] = 0.9 + 0.02 * torch.cos(2.0 * phase)
    return Clip(
        name="stepping",
        times=times,
        root_position=place,
        rotations=turned,
        joint_names=SKELETON.joint_names,
        loop=False,
        skeleton=SKELETON,
        source="there.bvh",
        licence="CC0",
        sha256="1" * 64,
        url="https://example.org",
        attribution="somebody",
    )


def feet_of(clip: Clip, period: float) -> Tensor:
    """(F, 2) each foot on the ground for 0.6 of the period, half a period apart."""
    phase = clip.times / period
    return torch.stack((phase % 1.0 < 0.6, (phase + 0.5) % 1.0 < 0.6), dim=1)


def test_where_a_clip_is_from_is_kept() -> None:
    clip = stepping()
    still = torch.zeros(3, dtype=torch.float64)
    edits = (
        editing.cut(clip, 0.5, 1.5),
        editing.shift(clip, still),
        editing.remove_frames(clip, [3]),
        editing.bridge(clip, "chest", 3, 5),
        editing.smooth(clip, 6.0),
        editing.close_loop(editing.cut(clip, 0.0, 1.0)),
    )
    for edited in edits:
        for name in ("name", "source", "licence", "sha256", "url", "attribution", "skeleton"):
            assert getattr(edited, name) == getattr(clip, name)


# ---------------------------------------------------------------------- frames


@settings(max_examples=30, deadline=None)
@given(st.floats(0.0, 3.0), st.floats(0.05, 1.0))
def test_a_cut_is_what_was_there(start: float, length: float) -> None:
    clip = stepping()
    part = editing.cut(clip, start, start + length)
    assert part.duration == pytest.approx(length)
    position, rotation = sample(clip, part.times + start)
    torch.testing.assert_close(part.root_position, position)
    torch.testing.assert_close(rotations.angle_between(part.rotations, rotation).max().item(), 0.0,
                               atol=1e-7, rtol=0.0)  # fmt: skip


@pytest.mark.parametrize(("start", "stop"), [(-0.1, 1.0), (1.0, 1.0), (2.0, 1.0), (0.0, 4.5)])
def test_a_cut_outside_the_clip_is_refused(start: float, stop: float) -> None:
    with pytest.raises(ConfigError, match=r"cannot be cut .* it lasts from 0 to 4 s"):
        editing.cut(stepping(), start, stop)


def test_removed_frames_leave_time_or_take_it_along() -> None:
    clip = stepping()
    kept = editing.remove_frames(clip, [10, 11])
    assert kept.num_frames == clip.num_frames - 2
    assert kept.duration == clip.duration
    shorter = editing.remove_frames(clip, [10, 11], close_up=True)
    assert shorter.duration == pytest.approx(clip.duration - 2.0 / RATE)
    torch.testing.assert_close(shorter.times.diff(), torch.full_like(shorter.times[1:], 1 / RATE))
    torch.testing.assert_close(shorter.rotations, kept.rotations)


def test_a_bridge_spans_what_is_beside_it() -> None:
    clip = stepping()
    bad = clip.rotations.clone()
    bad[20:23, 1] = rotations.from_heading(torch.tensor(1.0, dtype=torch.float64))
    mended = editing.bridge(replace(clip, rotations=bad), "chest", 20, 22)
    off = rotations.angle_between(mended.rotations, clip.rotations)
    assert off.max() < 0.02  # the chest turns by 0.1 rad a cycle
    assert (off[:, [0, *range(2, J)]] == 0.0).all()
    away = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    away[20:23] = 0.5
    back = editing.bridge(editing.shift(clip, away), "hips", 20, 22)
    torch.testing.assert_close(back.root_position, clip.root_position, atol=0.01, rtol=0.0)


@pytest.mark.parametrize(("first", "last", "like"), [(0, 2, 3), (118, 120, 117)])
def test_a_bridge_at_an_end_holds_the_frame_beside(first: int, last: int, like: int) -> None:
    clip = stepping()
    mended = editing.bridge(clip, "l_thigh", first, last)
    expected = clip.rotations[like, 2].expand(3, 4)
    assert rotations.angle_between(mended.rotations[first : last + 1, 2], expected).max() < 1e-7


# ---------------------------------------------------------------------- smoothing


def test_smoothing_keeps_slow_motion_and_takes_noise_away() -> None:
    clip = stepping(rate=120.0)
    rng = torch.Generator().manual_seed(0)
    noise = 0.01 * torch.randn(clip.num_frames, J, 3, generator=rng, dtype=torch.float64)
    noisy = replace(
        clip,
        rotations=rotations.multiply(clip.rotations, rotations.from_exponential_map(noise)),
    )

    def error(other: Clip) -> float:
        return (
            rotations.angle_between(other.rotations, clip.rotations).square().mean().sqrt().item()
        )

    assert error(editing.smooth(clip, 6.0)) < 0.002
    assert error(editing.smooth(noisy, 6.0)) < 0.5 * error(noisy)


def test_a_smoothed_loop_is_smooth_across_its_seam() -> None:
    loop = editing.close_loop(editing.cut(stepping(turning=0.5, rate=60.0), 0.0, 1.0))
    smooth = editing.smooth(loop, 6.0)
    assert smooth.loop
    _closes(smooth)
    torch.testing.assert_close(smooth.root_position, loop.root_position, atol=0.01, rtol=0.0)


def test_what_cannot_be_smoothed_is_left() -> None:
    clip = stepping()
    assert editing.smooth(clip, 20.0) is clip
    assert editing.smooth(walker(frames=4), 3.0).num_frames == 4


# ---------------------------------------------------------------------- loops


def _closes(loop: Clip, atol: float = 1e-3) -> None:
    """Poses and velocities of the last frame are those of the first, a cycle later."""
    turn = rotations.from_heading(torch.tensor(cycle_transform(loop).heading, dtype=torch.float64))
    first = torch.cat((rotations.multiply(turn, loop.rotations[0, :1]), loop.rotations[0, 1:]))
    assert rotations.angle_between(first, loop.rotations[-1]).max() < atol
    assert loop.root_position[0, 2].item() == pytest.approx(
        loop.root_position[-1, 2].item(), abs=atol
    )


@settings(max_examples=20, deadline=None)
@given(st.floats(0.8, 1.3), st.floats(-0.6, 0.6), st.integers(0, 2**31))
def test_any_clip_closes_and_keeps_its_travel(length: float, turning: float, seed: int) -> None:
    """Whatever the cut: exact at the seam, velocities that meet, the same way gone."""
    part = editing.cut(stepping(turning=turning, rate=60.0), 0.3, 0.3 + length)
    rng = torch.Generator().manual_seed(seed)
    lean = 0.2 * torch.rand(J, 3, generator=rng, dtype=torch.float64)
    share = (part.times / part.duration)[:, None, None]
    part = replace(
        part,
        rotations=rotations.multiply(part.rotations, rotations.from_exponential_map(share * lean)),
    )
    loop = editing.close_loop(part)
    assert loop.loop
    _closes(loop, 1e-9)
    before, after = cycle_transform(part), cycle_transform(loop)
    torch.testing.assert_close(after.displacement, before.displacement, atol=0.02, rtol=0.0)
    assert after.heading == pytest.approx(before.heading, abs=0.02)
    _, angular = velocities(loop)  # central: across the seam
    _, inside = velocities(replace(loop, loop=False))  # one-sided at the ends
    assert (angular[0] - inside[0]).norm(dim=-1).max() < 1.5
    assert (angular[-1] - inside[-1]).norm(dim=-1).max() < 1.5


def test_a_loop_that_closes_is_hardly_touched() -> None:
    part = editing.cut(stepping(rate=60.0), 0.0, 1.0)
    loop = editing.close_loop(part)
    assert rotations.angle_between(loop.rotations, part.rotations).max() < 0.01
    torch.testing.assert_close(loop.root_position, part.root_position, atol=2e-3, rtol=0.0)


@settings(max_examples=10, deadline=None)
@given(st.sampled_from([0.7, 1.0, 1.4]), st.sampled_from([-0.4, 0.0, 0.3]), st.booleans())
def test_the_loop_found_is_one_cycle(period: float, turning: float, told: bool) -> None:
    clip = stepping(period=period, turning=turning)
    loop = editing.find_loop(clip, feet_of(clip, period) if told else None)
    assert loop is not None
    assert (loop.last - loop.first) / RATE == pytest.approx(period, abs=1.01 / RATE)
    assert loop.mismatch < 0.1


def test_standing_still_is_no_loop_of_a_clip_that_walks() -> None:
    clip = stepping(seconds=3.0)
    wait = torch.arange(1, 91, dtype=torch.float64)
    waiting = replace(
        clip,
        times=torch.cat((clip.times, clip.times[-1] + wait / RATE)),
        root_position=torch.cat((clip.root_position, clip.root_position[-1:].expand(90, -1))),
        rotations=torch.cat((clip.rotations, clip.rotations[-1:].expand(90, -1, -1))),
    )
    loop = editing.find_loop(waiting)
    assert loop is not None
    assert loop.last <= 92
    assert loop.last - loop.first == pytest.approx(30, abs=1)


def test_a_long_clip_is_searched_in_good_time_and_found_to_the_frame() -> None:
    clip = stepping(seconds=40.0, rate=120.0)
    loop = editing.find_loop(clip, feet_of(clip, 1.0))
    assert loop is not None
    assert loop.last - loop.first == pytest.approx(120, abs=1)


def test_no_loop_in_half_a_cycle() -> None:
    clip = editing.cut(stepping(), 0.0, 0.5)
    assert editing.find_loop(clip) is None
    assert editing.find_loop(clip, feet_of(clip, 1.0)) is None


# ---------------------------------------------------------------------- limbs

LEG = replace(
    SKELETON,
    joint_names=("hips", "thigh", "shin", "foot"),
    parents=(-1, 0, 1, 2),
    offsets=torch.tensor([[0, 0, 0], [0, 0.1, 0], [0.02, 0, -0.45], [0, 0, -0.42]]).numpy(),
    tips={},
)


@settings(max_examples=40, deadline=None)
@given(st.integers(0, 2**31), st.floats(0.0, 0.08), st.sampled_from([None, (0.0, 1.0, 0.0)]))
def test_a_foot_goes_where_it_is_sent(
    seed: int, distance: float, axis: tuple[float, float, float] | None
) -> None:
    rng = torch.Generator().manual_seed(seed)
    vectors = 0.6 * torch.randn(8, 4, 3, generator=rng, dtype=torch.float64)
    vectors[:, 2] = torch.tensor([0.0, 1.0, 0.0]) * (
        0.9 + 0.5 * torch.rand(8, 1, generator=rng, dtype=torch.float64)
    )
    clip = Clip(
        name="leg",
        times=torch.arange(8, dtype=torch.float64),
        root_position=torch.randn(8, 3, generator=rng, dtype=torch.float64),
        rotations=rotations.from_exponential_map(vectors),
        joint_names=LEG.joint_names,
        loop=False,
        skeleton=LEG,
    )
    way = torch.randn(8, 3, generator=rng, dtype=torch.float64)
    way = distance * way / way.norm(dim=-1, keepdim=True)
    moved = editing.reach(clip, "foot", way, axis)
    (before, turned), (after, still) = forward_kinematics(clip), forward_kinematics(moved)
    torch.testing.assert_close(after[:, 3], before[:, 3] + way, atol=1e-9, rtol=0.0)
    torch.testing.assert_close(after[:, :2], before[:, :2])
    assert rotations.angle_between(still[:, 3], turned[:, 3]).max() < 1e-7
    if axis is not None:  # a hinge stays one
        knee = rotations.to_exponential_map(moved.rotations[:, 2])
        assert knee[:, [0, 2]].abs().max() < 1e-9


def test_out_of_reach_a_leg_is_stretched() -> None:
    clip = Clip(
        name="leg",
        times=torch.arange(2, dtype=torch.float64),
        root_position=torch.zeros(2, 3, dtype=torch.float64),
        rotations=rotations.from_exponential_map(0.3 * torch.ones(2, 4, 3, dtype=torch.float64)),
        joint_names=LEG.joint_names,
        loop=False,
        skeleton=LEG,
    )
    way = torch.tensor([[0.0, 0.0, -5.0], [0.0, 0.0, 0.0]], dtype=torch.float64)
    positions, _ = forward_kinematics(editing.reach(clip, "foot", way))
    length = (positions[0, 3] - positions[0, 1]).norm().item()
    assert length == pytest.approx(math.hypot(0.02, 0.45) + 0.42, abs=1e-6)


def test_what_has_no_limb_is_refused() -> None:
    clip = stepping()
    still = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    with pytest.raises(ConfigError, match="'l_shin' has no two joints"):
        editing.reach(clip, "l_shin", still)
    with pytest.raises(FileError, match="has no skeleton"):
        editing.reach(replace(clip, skeleton=None), "l_shin", still)
