"""A jump that begins where a run-up ended, as a pack: its bank comes along, and its bar is shown."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest
import torch
from miniatures import AT_ONCE
from worlds import SMALL

from understudy.command.cli import main
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_play.command import record
from understudy_play.player import Player
from understudy_skills import bank
from understudy_skills.pack_inputs import PackInputs
from understudy_skills.skill import open_skill

TINY = (
    "task=jumping/high", *SMALL, "num_worlds=4", "control.substeps=5", "learner.rollout_steps=8",
    "budget.samples=32", *AT_ONCE, "run.video_seconds=0",
)  # fmt: skip


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A pack alone: the bank of its 100 states and its run are gone."""
    place = tmp_path_factory.mktemp("packed_jump")
    built = build_environment(load_experiment(["task=jumping/high", "num_worlds=100"])).environment
    built.reset(seed=1)
    states = {name: built.table[name].clone() for name in ("qpos", "qvel")}
    built.close()
    bank.save(place / "ends", states, {})
    starts = f"+initial_states={{name: jumping/harvested, file: {place / 'ends'}, alpha: 0.3}}"
    assert main(["train", *TINY, "initial_states=null", starts, f"run.dir={place / 'run'}"]) == 0
    file = place / "alone" / "jump.json"
    words = ["difficulty=0.5", "--pack", str(file)]
    assert main(["play", str(place / "run"), *words]) == 0
    shutil.rmtree(place / "run")
    for left in bank.files(place / "ends"):
        left.unlink()
    return file


def test_it_begins_in_the_states_of_its_bank(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    skill = open_skill(str(packed))
    assert "ends, alpha: 0.3}" in skill.card["overrides"][-2].partition("file: ")[2]
    player = Player(skill)
    try:
        joints = player.shown()["qpos"][7:]
        inputs = skill.experiment.inputs
        assert isinstance(inputs, PackInputs)
        held = inputs.banks["bank ends"].states["qpos"][:: bank.HELD_OUT, 7:]
        assert float((held - joints).abs().amax(dim=1).min()) < 1e-6
    finally:
        player.close()
    assert main(["evaluate", str(packed), "episodes=4", "half_step=false"]) == 0


def test_its_bar_and_mat_are_shown(packed: Path) -> None:
    pytest.importorskip("viser", reason="viser is not installed (the extra 'view')")
    from understudy_play.page import Page
    from understudy_viewer.page import free_port

    player = Player(open_skill(str(packed)))
    tracks = record(player, 0.1)
    np.testing.assert_allclose(tracks["obstacle_height"], 1.25)
    page = Page(player, "127.0.0.1", free_port("127.0.0.1", 0))
    try:
        page.advance()
        things = {thing.name.split("/")[-2]: thing for thing in page._things}
        assert things.keys() == {"obstacle", "mat"}
        top = things["obstacle"].position[2] + things["obstacle"].vertices[:, 2].max()
        assert top == pytest.approx(1.25)
        assert things["mat"].position[2] == pytest.approx(1.25 - 0.7)
        assert torch.equal(player.shown()["obstacle_height"], torch.tensor(1.25))
    finally:
        page.close()
