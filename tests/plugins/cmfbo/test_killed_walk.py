"""The search of the thesis, killed at random moments, ends as one that never was and repeats nothing."""

from __future__ import annotations

from pathlib import Path

import pytest
from killed_sweeps import check_kills, never_killed, rows

#: The search of the thesis, with DeepMimic's walk as its task, made small: six trials, of which the last
#: is at full difficulty and begins from an earlier one.
WALK = (
    "search=cmfbo/walk",
    "num_worlds=8",
    "learner.rollout_steps=8",
    "budget.samples=1024",
    "evaluation.every_samples=256",
    "evaluation.episodes=4",
    "evaluation.final_episodes=4",
    "evaluation.seconds=2.0",
    "simulator.threads=1",
    "checkpoint.minutes=0",
    "run.video_seconds=0",
    "outer_loop.parameters={learner.batch_size: {low: 16, high: 64}}",
    "outer_loop.trials=6",
    "outer_loop.initial=3",
    "outer_loop.budget=null",
)


@pytest.mark.slow
@pytest.mark.timeout(1800)
@pytest.mark.parametrize("executor", ["in_process", "processes"])
def test_the_walk_killed_at_random_moments(executor: str, tmp_path: Path) -> None:
    straight = never_killed(WALK, tmp_path / "straight")
    check_kills(WALK, 6, executor, 10, straight, tmp_path / "killed")
    asked = [r["trial"] for r in rows(tmp_path / "killed") if r["event"] == "asked"]
    assert asked[-1]["fidelity"] == 1.0
    assert asked[-1]["start"]["trial"] in [t["key"] for t in asked[:-1]]
