"""Run-ups: where they begin and end, and how one is joined with a jump."""

from __future__ import annotations

import math
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from torch import Tensor

from understudy.errors import FileError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_characters.initial_states import reference_states
from understudy_characters.scene import reference_motion
from understudy_jumping.join import _frames, gap, joined
from understudy_jumping.run_up import Arrival
from understudy_motion.clip import Clip
from understudy_tensors import rotations


def test_it_ends_at_the_take_off(plugins: Plugins) -> None:
    """Held to its clip by nothing but the targets, 0.2 s before the take-off."""
    experiment = load_experiment(
        ["task=jumping/run_up", "num_worlds=4", "fields.arrival.at=0.5",
         "initial_states.begin=0.3", "initial_states.end=0.3"], plugins
    )  # fmt: skip
    env = build_environment(experiment).environment
    env.reset(seed=0)
    for _ in range(5):
        assert not env.advance(torch.zeros(4, env.action_size)).ended.any()
    step = env.advance(torch.zeros(4, env.action_size))
    assert step.terminated.all()
    assert not step.failed.any()
    reward = env.table["takeoff_match"] * env.table["takeoff_rest"] * 10
    assert (step.rewards > reward).all()
    assert (step.rewards <= reward + 1.0).all()
    assert float(env.table["motion_time"][0]) == pytest.approx(0.5, abs=1e-4)
    env.close()


@pytest.mark.parametrize(("asked", "wanted"), [(1.0, math.exp(-1.2)), (0.0, 1.0)])
def test_the_rest_of_the_take_off_is_the_clips(
    asked: float, wanted: float, plugins: Plugins
) -> None:
    """1 in the clip's own state. A fall of 1 m/s from 10 cm below it costs exp(-0.7 - 0.5), unless
    nothing of the rest is asked."""
    words = ["task=jumping/run_up", "num_worlds=3", f"fields.arrival.rest={asked}",
             "fields.arrival.at=0.5", "initial_states.begin=0.5", "initial_states.end=0.5"]  # fmt: skip
    built = build_environment(load_experiment(words, plugins))
    env = built.environment
    env.reset(seed=0)
    time = env.table["motion_time"].clone()
    torch.testing.assert_close(env.table["takeoff_rest"], torch.ones(3), atol=2e-3, rtol=0)
    options = Arrival.Options(at=0.5, rest=asked)
    clip = reference_states(reference_motion(built.context), time)
    qpos, qvel = clip["qpos"].clone(), clip["qvel"].clone()
    qpos[:, 2] -= 0.1
    qvel[:, 2] -= 1.0
    found = Arrival(options, built.context).compute(time, qpos, qvel)["takeoff_rest"]
    torch.testing.assert_close(found, torch.full((3,), wanted), atol=2e-3, rtol=0)
    env.close()


def test_it_begins_within_its_window(plugins: Plugins) -> None:
    experiment = load_experiment(
        ["task=jumping/run_up", "num_worlds=32", "initial_states.begin=0.2",
         "initial_states.end=0.4"], plugins
    )  # fmt: skip
    for evaluating in (False, True):
        env = build_environment(experiment, evaluating=evaluating).environment
        env.reset(seed=0)
        start = env.table["motion_start"]
        if evaluating:
            np.testing.assert_allclose(start, 0.2)
        else:
            assert 0.2 <= float(start.min()) < 0.22 < 0.38 < float(start.max()) <= 0.4
        env.close()


def clip(name: str, seed: int, joints: tuple[str, ...] = ("root", "knee")) -> Clip:
    generator = torch.Generator().manual_seed(seed)
    turned = torch.randn(5, len(joints), 4, generator=generator, dtype=torch.float64)
    return Clip(
        name=name,
        times=torch.linspace(0.0, 0.4, 5, dtype=torch.float64),
        root_position=torch.randn(5, 3, generator=generator, dtype=torch.float64),
        rotations=rotations.normalize(turned),
        joint_names=joints,
        loop=False,
        source=name,
    )


def steady(frames: int) -> Clip:
    """It moves by 0.1 m along x, 0.02 m upwards, and turns by 0.05 rad to the left, its knee by 0.2 rad,
    in every frame of 0.1 s."""
    count = torch.arange(frames, dtype=torch.float64)
    angles = torch.zeros(frames, 2, 3, dtype=torch.float64)
    angles[:, 0, 2], angles[:, 1, 1] = 0.05 * count, 0.2 * count
    place = torch.stack([0.1 * count, 0 * count, 1 + 0.02 * count], dim=1)
    return replace(
        clip("run_up", 0),
        times=0.1 * count,
        root_position=place,
        rotations=rotations.from_exponential_map(angles),
    )


def begun_after(run_up: Clip, turn: Tensor) -> Clip:
    """A motion elsewhere, turned by `turn`, that begins where the steady `run_up` is a frame after its
    last."""
    jump = clip("jump", 1)
    next_pose = steady(run_up.num_frames + 1)
    jump.rotations[0] = next_pose.rotations[-1]
    jump.rotations[0, 0] = rotations.multiply(turn, next_pose.rotations[-1, 0])
    jump.root_position[0, 2] = next_pose.root_position[-1, 2]
    return jump


TURN = rotations.from_heading(torch.tensor(1.2, dtype=torch.float64))


def test_a_run_up_is_moved_to_its_jump() -> None:
    """A recording lacks the state in which its episode ended: the jump begins one frame later."""
    run_up = steady(5)
    jump = begun_after(run_up, TURN)
    whole = joined(run_up, jump)
    assert whole.num_frames == 10
    np.testing.assert_allclose(whole.times.diff(), 0.1)
    torch.testing.assert_close(whole.root_position[5:], jump.root_position)
    torch.testing.assert_close(whole.rotations[5:], jump.rotations)
    # it goes on as it moved
    steps = whole.root_position[:6].diff(dim=0)
    torch.testing.assert_close(steps, steps[:1].expand(5, 3))
    turned = rotations.angle_between(whole.rotations[:5], whole.rotations[1:6])
    torch.testing.assert_close(turned, torch.tensor([[0.05, 0.2]]).double().expand(5, 2))
    # rigidly: distances and heights stay, joints too
    ours, theirs = whole.root_position[:5], run_up.root_position
    np.testing.assert_allclose(torch.cdist(ours, ours), torch.cdist(theirs, theirs), atol=1e-9)
    np.testing.assert_allclose(ours[:, 2], theirs[:, 2], atol=1e-9)
    torch.testing.assert_close(whole.rotations[:5, 1], run_up.rotations[:, 1])


def test_how_far_apart_they_are_where_they_join() -> None:
    """The heading aside, which joining takes up."""
    run_up = steady(5)
    jump = begun_after(run_up, TURN)
    jump.root_position[0, 2] += 0.03
    assert gap(run_up, jump) == pytest.approx((0.0, 0.03), abs=1e-6)
    knee = rotations.from_exponential_map(torch.tensor([0.0, 0.4, 0.0], dtype=torch.float64))
    jump.rotations[0, 1] = rotations.multiply(knee, jump.rotations[0, 1])
    assert gap(run_up, jump) == pytest.approx((0.4, 0.03), abs=1e-6)


def test_motions_of_two_figures_are_not_joined() -> None:
    with pytest.raises(FileError, match="same character"):
        joined(clip("run_up", 0), replace(clip("jump", 1), joint_names=("root", "elbow")))


def test_a_video_has_frames_of_minutes_at_most(tmp_path: Path) -> None:
    """However much time a recording says is between its frames."""
    slow = clip("jump", 1)
    with pytest.raises(FileError, match=r"too many frames .* write a clip"):
        _frames(replace(slow, times=1e5 * slow.times), tmp_path, 60.0)
