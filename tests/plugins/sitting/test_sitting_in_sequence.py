"""A turn and sitting down after it, by Algorithm 1 of the dressing paper."""

from __future__ import annotations

import json
from pathlib import Path

from understudy.command.cli import main
from understudy_skills import bank

TINY = (
    "num_worlds=4", "budget.samples=64", "evaluation.episodes=2", "evaluation.final_episodes=2",
    "evaluation.seconds=0.3", "policy.hidden=[16]", "learner.minibatches=2", "learner.epochs=1",
    "run.video_seconds=0", "checkpoint.minutes=0",
)  # fmt: skip


def test_both_passes_run(tmp_path: Path) -> None:
    """Sitting's second pass begins where turns ended, by a part that tells when its clip begins."""
    # an untrained turn falls before its time is over
    given = ("outer_loop.count=8", "outer_loop.ending=any", f"outer_loop.each=[{','.join(TINY)}]")
    assert main(["sweep", "search=sitting/algorithm_1", *given, f"run.dir={tmp_path}"]) == 0
    assert bank.load(tmp_path / "turn_ends")["qpos"].shape[0] == 8
    begun = json.loads((tmp_path / "sit" / "run.json").read_text())["config"]["initial_states"]
    assert begun["name"] == "sitting/where_others_ended"
    assert begun["banks"] == [str(tmp_path / "turn_ends")]
    rows = [json.loads(row) for row in (tmp_path / "turn" / "metrics.jsonl").open()]
    assert all(row["reward/next_start"] < 0 for row in rows), "drawn to where sitting begins"
