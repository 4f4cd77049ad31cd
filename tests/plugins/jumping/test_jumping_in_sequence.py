"""A run-up and the jump after it, by Algorithm 1 of the dressing paper."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import torch

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy_sequencing.algorithm import stages_of
from understudy_skills import bank

SEARCH = "search=jumping/algorithm_1"
#: A generated run in place of the captured one, whose clip is not everywhere, shortly before its take-off.
GENERATED = (
    "outer_loop.subtasks.run_up=[experiment=jumping/run_up_small, motion.name=run, motion.file=null, "
    "fields.arrival.at=2.0, initial_states.begin=1.8, initial_states.end=1.9]"
)
TINY = (
    "num_worlds=8", "budget.samples=64", "evaluation.episodes=2", "evaluation.final_episodes=2",
    "evaluation.seconds=0.3", "policy.hidden=[16]", "learner.minibatches=2", "learner.epochs=1",
    "run.video_seconds=0", "checkpoint.minutes=0",
)  # fmt: skip


def test_the_jump_goes_on_where_the_run_up_ends(plugins: Plugins) -> None:
    options: Any = load_experiment([SEARCH], plugins).need("outer_loop").options
    stages = stages_of(options)
    assert list(stages) == [
        "jump_starts", "run_up_first", "jump_first", "run_up", "run_up_ends", "jump"
    ]  # fmt: skip
    for name in ("run_up_first", "run_up"):
        assert "file: '{jump_starts}'" in stages[name][1]
    assert stages["jump_first"] == ("experiment=jumping/high_small",)
    assert stages["jump"] == (
        "experiment=jumping/high_small", "initial_states=null",
        "+initial_states={name: jumping/harvested, file: '{run_up_ends}'}", "start.run='{jump_first}'",
    )  # fmt: skip


def test_both_passes_run(tmp_path: Path, plugins: Plugins) -> None:
    few = "outer_loop.ends={run_up: [job.ending=success, num_worlds=16]}"
    given = ("outer_loop.count=16", f"outer_loop.each=[{','.join(TINY)}]", GENERATED, few)
    assert main(["sweep", SEARCH, *given, f"run.dir={tmp_path}"]) == 0
    for name in ("run_up_first", "run_up"):
        rows = [json.loads(row) for row in (tmp_path / name / "metrics.jsonl").open()]
        assert all(-1.5 < row["reward/next_start"] < 0 for row in rows), "drawn to the take-off"
    starts, ends = (bank.load(tmp_path / name) for name in ("jump_starts", "run_up_ends"))
    assert starts["link_rotations"].shape == ends["link_rotations"].shape == (16, 15, 6)
    # elsewhere, and facing another way, each limb is turned as where a run-up ended
    begun = f"+initial_states={{name: jumping/harvested, file: {tmp_path / 'run_up_ends'}}}"
    env = build_environment(
        load_experiment(
            ["experiment=jumping/high_small", "num_worlds=8", "initial_states=null", begun], plugins
        )
    ).environment
    env.reset(seed=0)
    limbs = env.table["link_rotations"].flatten(1)
    assert torch.cdist(limbs, ends["link_rotations"].flatten(1)).amin(dim=1).max() < 1e-3
    turned = env.table["qpos"][:, 3:7].unsqueeze(1) - ends["qpos"][:, 3:7]
    assert turned.norm(dim=2).min() > 0.1
    env.close()
