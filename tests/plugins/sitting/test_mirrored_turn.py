"""The left turn that ships is the right one's mirror image, and lags at half its time step."""

from __future__ import annotations

import sys
from pathlib import Path

import pytest
import torch

sys.path.insert(0, str(Path(__file__).resolve().parents[3] / "benchmarks"))

from mirrored_turn import LEFT, RIGHT, mirror

from understudy.setup.building import build_environment
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import open_skill
from understudy_tensors.rotations import pitch_yaw_roll


def test_it_is_the_right_ones_mirror_image() -> None:
    """Exactly, and twice mirrored the right one itself."""
    right, left = open_skill(RIGHT), open_skill(LEFT)
    made = mirror(right)
    assert left.policy.keys() == made.keys()
    for name, value in made.items():
        torch.testing.assert_close(left.policy[name], value, rtol=0, atol=0)
    again = mirror(type(left)(LEFT, left.experiment, made, left.samples, left.card))
    for name, value in again.items():
        torch.testing.assert_close(value, right.policy[name], rtol=0, atol=0)


_LAGS = "at half its time step it turns by 48 degrees: it stays up and on course, and lags 2 degrees more than may be"


@pytest.mark.parametrize(
    "substeps", [4, pytest.param(8, marks=pytest.mark.xfail(reason=_LAGS, strict=True))]
)
def test_it_turns_as_far_at_half_the_time_step(substeps: int) -> None:
    """Its clip turns by 63° in two seconds, this by 72°; the one that was learned by itself by 65° and 25°."""
    words = [
        "device=cpu",
        "num_worlds=1",
        f"control.substeps={substeps}",
        "initial_states.span=[0,0]",
    ]
    skill = open_skill(LEFT, words)
    built = build_environment(skill.experiment, num_worlds=1)
    policy = build_policy(skill.experiment, built.context)
    skill.give(policy)
    seen = built.environment.reset(0, "x")
    with torch.no_grad():
        for _ in range(120):
            seen = built.environment.step(policy.distribution(seen).mode()).observations
    yaw = float(pitch_yaw_roll(built.environment.table["qpos"][:, 3:7])[0, 1])
    built.environment.close()
    assert 0.87 < yaw < 1.4
