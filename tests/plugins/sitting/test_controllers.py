"""Controllers above finished skills, from training to what is judged and drawn of them.

One skill of a few samples stands for all: what it can do is no matter here.
"""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from understudy.command.cli import main
from understudy_sitting.trials import FILE

TINY = (
    "simulator=mujoco", "device=cpu", "learner.minibatches=1", "evaluation.episodes=2",
    "evaluation.final_episodes=2", "evaluation.seconds=1", "evaluation.criterion=null", "run.video_seconds=0",
)  # fmt: skip


@pytest.fixture(scope="module")
def skill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("skills") / "walk"
    words = ("experiment=sitting/walk", *TINY, "num_worlds=4", "budget.samples=64")
    assert main(["train", *words, f"run.dir={folder}"]) == 0
    return folder


@pytest.fixture(scope="module", params=["sitting/meta", "sitting/in_order"])
def controller(
    request: pytest.FixtureRequest, skill: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("controllers") / "run"
    three = f"actuation.runs=['{skill}','{skill}','{skill}']"
    words = (f"experiment={request.param}", *TINY, three, "num_worlds=4", "budget.samples=32")
    assert main(["train", *words, f"run.dir={folder}"]) == 0
    return folder


def test_trials_say_what_was_judged(controller: Path) -> None:
    zone = "initial_states.zone=2"
    assert main(["sitting", "trials", str(controller), "--trials", "5", zone]) == 0
    found = json.loads((controller / FILE).read_text())
    assert found["judged"] == {"overrides": [zone], "seed": 0, "samples": 32}
    assert found["zones"].keys() == {"2"}
    assert found["all"]["trials"] == 5
    assert found["all"]["success_rate"] == 0.0, "nobody sits for 3 s in 1 s"
    assert 0.5 < found["all"]["distance_mean"] < 2.5


def test_a_room_is_filmed(controller: Path, tmp_path: Path) -> None:
    film = tmp_path / "room.mp4"
    words = ("--trials", "2", "evaluation.seconds=1")
    assert main(["sitting", "room", str(controller), str(film), *words]) == 0
    assert film.stat().st_size > 1000
