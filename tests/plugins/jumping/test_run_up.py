"""Run-ups: where they begin and end, and how one is joined with a jump."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from understudy.errors import FileError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_jumping.join import _frames, joined
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
    reward = env.table["takeoff_match"] * 10
    assert (step.rewards > reward).all()
    assert (step.rewards <= reward + 1.0).all()
    assert float(env.table["motion_time"][0]) == pytest.approx(0.5, abs=1e-4)
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


def test_a_run_up_is_moved_to_its_jump() -> None:
    run_up, jump = clip("run_up", 0), clip("jump", 1)
    # the jump begins in the run-up's last pose, elsewhere and facing another way
    turn = rotations.from_heading(torch.tensor(1.2, dtype=torch.float64))
    jump.rotations[0] = run_up.rotations[-1]
    jump.rotations[0, 0] = rotations.multiply(turn, run_up.rotations[-1, 0])
    jump.root_position[0, 2] = run_up.root_position[-1, 2]
    whole = joined(run_up, jump)
    assert whole.num_frames == 9
    np.testing.assert_allclose(whole.times.diff(), 0.1)
    torch.testing.assert_close(whole.root_position[4:], jump.root_position)
    np.testing.assert_allclose(
        rotations.angle_between(whole.rotations[4], jump.rotations[0]), 0.0, atol=1e-6
    )
    # rigidly: distances and heights stay, joints too
    for ours, theirs in ((whole.root_position[:5], run_up.root_position),):
        np.testing.assert_allclose(torch.cdist(ours, ours), torch.cdist(theirs, theirs), atol=1e-9)
        np.testing.assert_allclose(ours[:, 2], theirs[:, 2], atol=1e-9)
    torch.testing.assert_close(whole.rotations[:5, 1], run_up.rotations[:, 1])


def test_motions_of_two_figures_are_not_joined() -> None:
    with pytest.raises(FileError, match="same character"):
        joined(clip("run_up", 0), replace(clip("jump", 1), joint_names=("root", "elbow")))


def test_a_video_has_frames_of_minutes_at_most(tmp_path: Path) -> None:
    """However much time a recording says is between its frames."""
    slow = clip("jump", 1)
    with pytest.raises(FileError, match=r"too many frames .* write a clip"):
        _frames(replace(slow, times=1e5 * slow.times), tmp_path)
