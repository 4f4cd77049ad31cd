"""A pack has the grip that its run was given as a file, and is played where that file is not."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
import torch

import understudy_gripping
from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy_skills.skill import open_skill

GRIP = Path(understudy_gripping.__file__).parent / "grips" / "standard.json"


def test_a_grip_of_ones_own_goes_along(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    own = tmp_path / "my grips" / "own.json"
    own.parent.mkdir()
    own.write_bytes(GRIP.read_bytes())
    words = [
        "num_worlds=2", "learner.minibatches=2", "evaluation.final_episodes=32", "evaluation.seconds=0.1",
        "run.video_seconds=0",
    ]  # fmt: skip
    assert main(["train", "experiment=chopsticks/open_close_small", "budget.samples=64",
                 f"grip.file='{own}'", "run.dir=run", *words]) == 0  # fmt: skip
    assert main(["play", "run", "--pack", "far/pack.json", *words[2:4]]) == 0
    own.unlink()
    (tmp_path / "run").rename("gone")
    card = json.loads(json.loads(Path("far/pack.json").read_text())["content"])
    assert card["meta"]["config"]["grip"]["file"] == "own.json", "of no one's folders"
    skill = open_skill("far/pack.json")
    built = build_environment(skill.experiment, num_worlds=1)
    packaged = [
        "experiment=chopsticks/open_close_small", "run.dir=packaged", "budget.samples=64",
        *words,
    ]  # fmt: skip
    assert main(["train", *packaged]) == 0
    beside = build_environment(open_skill("packaged").experiment, num_worlds=1)
    torch.testing.assert_close(built.environment.table["qpos"], beside.environment.table["qpos"])
    built.environment.close()
    beside.environment.close()
    assert main(["play", "far/pack.json", "--unpack", "again"]) == 0
    assert (tmp_path / "again" / "inputs" / "1" / "own.json").read_bytes() == GRIP.read_bytes()
