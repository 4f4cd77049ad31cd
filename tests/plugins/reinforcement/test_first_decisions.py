"""A training in which every decision fails an episode says so once, and by which term."""

from __future__ import annotations

from pathlib import Path

import pytest

from understudy.command.cli import main

TINY = (
    "experiment=sitting/sit", "num_worlds=2", "budget.samples=64", "learner.rollout_steps=16", "learner.minibatches=2",
    "evaluation.episodes=2", "evaluation.final_episodes=2", "evaluation.seconds=0.1", "run.video_seconds=0",
)  # fmt: skip


@pytest.mark.parametrize(("height", "told"), [("54", 1), ("0.54", 0)])
def test_a_limit_in_another_unit_is_told_of(
    tmp_path: Path, height: str, told: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """The torso was to be above 54 m, not cm: it trained to its budget on episodes of one decision each."""
    words = [*TINY, f"termination.terms.low.height={height}", f"run.dir={tmp_path / 'run'}"]
    assert main(["train", *words]) == 0
    said = capsys.readouterr().err
    sentence = "All 32 episodes of an iteration failed at their first decision, by termination.terms.low: nothing can be learned so."
    assert said.count(sentence) == said.count("first decision") == told
