"""Sweeps: every variant with every seed, resumable from the journal."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from understudy.command.cli import main
from understudy_sweeps import sweep as module

QUICK = [
    "experiment=spacetime/walk", "num_worlds=4", "learner.rollout_steps=4", "learner.minibatches=2",
    "policy.feedback.hidden=[8]", "budget.samples=16", "evaluation.episodes=2",
    "evaluation.seconds=0.2", "outer_loop=grid", "executor=in_process",
    "outer_loop.seeds=[0,1]",
    "outer_loop.variants={base: [], uniform: ['initial_states=spacetime/uniform']}",
]  # fmt: skip


def test_runs_every_trial_once_and_goes_on_after_a_stop(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    folder = tmp_path / "sweep"
    command = ["sweep", *QUICK, f"run.dir={folder}"]
    run_trial, count = module.run_trial, 0

    def stopping(*arguments: object) -> object:
        nonlocal count
        count += 1
        if count == 3:
            raise KeyboardInterrupt
        return run_trial(*arguments)  # pyright: ignore[reportArgumentType]

    monkeypatch.setattr(module, "run_trial", stopping)
    with pytest.raises(KeyboardInterrupt):
        main(command)
    done = [json.loads(line)["key"] for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert done == ["base/seed0", "base/seed1"]
    assert main(command) == 0
    rows = [json.loads(line) for line in (folder / "journal.jsonl").read_text().splitlines()]
    assert [r["key"] for r in rows] == [
        "base/seed0",
        "base/seed1",
        "uniform/seed0",
        "uniform/seed1",
    ]
    assert {r["status"] for r in rows} == {"ok"}
    assert capsys.readouterr().out.splitlines()[-1] == f"sweep: {folder}"
    summary = json.loads((folder / "summary.json").read_text())
    assert [(r["variant"], r["seeds"]) for r in summary] == [("base", 2), ("uniform", 2)]


def test_a_trial_that_fails_is_recorded(tmp_path: Path) -> None:
    folder = tmp_path / "sweep"
    quick = [o for o in QUICK if not o.startswith("outer_loop.variants")]
    assert (
        main(
            ["sweep", *quick, "outer_loop.variants={odd: ['learner.clip=-1']}", f"run.dir={folder}"]
        )
        == 0
    )
    row = json.loads((folder / "journal.jsonl").read_text().splitlines()[0])
    assert row["status"].startswith("failed: learner.clip") or "clip" in row["status"]
    assert row["objective"] is None
