"""Killed in the middle and resumed, by the command line: every miniature ends as if it never was."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import pytest
from commands import begin, kill, wait_for
from miniatures import JOBS, QUICK, TRAININGS, overrides_of
from worlds import assert_same_state

from understudy.command.cli import main
from understudy.records import checkpoint, runs
from understudy_skills import bank

#: Budgets that leave some iterations before and after the kill at the third.
BUDGET = {"sleeve_bank": ("job.count=300", "job.decisions=8"), "poses": ("budget.samples=4096",)}
USUAL = ("num_worlds=16", "learner.rollout_steps=8", "budget.samples=768")


def kill_once(process: Any, there: Path) -> None:
    """SIGKILL as soon as `there` exists."""
    wait_for(process, there)
    kill(process)


def metrics(run: runs.Run) -> list[dict[str, Any]]:
    """Its rows, less what clocks say."""
    clocks = ("seconds", "samples_per_second", "collect_share")
    return [{k: v for k, v in row.items() if k not in clocks} for row in run.metrics()]


def assert_same_run(one: Path, other: Path) -> None:
    first, second = runs.open_run(one), runs.open_run(other)
    last = checkpoint.newest(first.checkpoints)[0].name
    assert last == checkpoint.newest(second.checkpoints)[0].name
    (state, _), (again, _) = (checkpoint.load(run.checkpoints / last) for run in (first, second))
    assert_same_state(state, again)
    assert metrics(first) == metrics(second)
    assert [row["iteration"] for row in first.metrics()] == list(range(1, int(last) + 1))


@pytest.mark.parametrize("name", [*TRAININGS, *JOBS])
def test_killed_and_resumed(name: str, built_on: Path, tmp_path: Path) -> None:
    overrides = (*overrides_of(name, built_on), *BUDGET.get(name, USUAL), *QUICK)
    straight, cut = tmp_path / "straight", tmp_path / "cut"
    child = begin("train", *overrides, f"run.dir={cut}")
    kill_once(child, cut / "checkpoints/00000003.json")
    assert not (cut / "evaluation.json").exists()
    assert main(["train", *overrides, f"run.dir={straight}"]) == 0
    assert main(["resume", str(cut)]) == 0
    assert_same_run(straight, cut)
    if name == "sleeve_bank":
        assert_same_state(bank.load(straight), bank.load(cut))
        assert len(bank.load(cut)["drag"]) == 300


def test_a_killed_search_goes_on(tmp_path: Path) -> None:
    """In its third trial, which begins from the best of the first two."""
    overrides = (
        "search=miniature/cmfbo", *USUAL, *QUICK, "evaluation.every_samples=256",
        "evaluation.seconds=2.0",
    )  # fmt: skip
    straight, cut = tmp_path / "straight", tmp_path / "cut"
    child = begin("sweep", *overrides, f"run.dir={cut}")
    kill_once(child, cut / "trial2/checkpoints/00000003.json")
    assert main(["sweep", *overrides, f"run.dir={straight}"]) == 0
    assert main(["sweep", *overrides, f"run.dir={cut}"]) == 0
    for trial in ("trial0", "trial1", "trial2", "trial3"):
        assert_same_run(straight / trial, cut / trial)
    journal = [json.loads(line) for line in (cut / "journal.jsonl").read_text().splitlines()]
    starts = [row["trial"]["start"] for row in journal if row["event"] == "asked"]
    assert starts[:2] == [None, None]
    assert all(start["trial"] in ("trial0", "trial1") for start in starts[2:3])
    origin = runs.open_run(cut / "trial2").info["sources"]["start"]["run"]
    assert origin == str(cut / starts[2]["trial"])
    tables = [(folder / "summary.json").read_text() for folder in (straight, cut)]
    assert tables[0] == tables[1]
