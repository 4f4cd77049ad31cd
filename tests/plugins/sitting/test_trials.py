"""What trials report, and the page of it."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace
from typing import Any, ClassVar

import pytest
import torch
from sitting_tasks import build

from understudy.command.cli import main
from understudy.records.runs import Run
from understudy_sitting.clips import generated_step_back, generated_whole
from understudy_sitting.kinematics import minimum_distances
from understudy_sitting.trials import FILE, TransitionsSection, _carry_out, _figures


def test_success_is_three_seconds_of_sitting_and_contact_stands_beside_it(tmp_path: Path) -> None:
    found = {
        "zone": torch.tensor([1.0, 1.0, 2.0, 3.0]),
        "seated": torch.tensor([3.0, 2.9, 10.0, 0.0]),
        "contact": torch.tensor([3.1, 3.0, 10.0, 0.0]),
        "distance": torch.tensor([0.1, 0.3, 0.2, 1.0]),
    }
    counts = torch.zeros(2, 4, 4)
    counts[0, 0, 2], counts[0, 0, 0], counts[1, 0, 1] = 3, 1, 2
    figures = _figures(found, counts)
    assert figures["all"]["success_rate"] == 0.5
    assert figures["zones"]["1"]["success_rate"] == 0.5
    assert figures["all"]["contact_rate"] == 0.75
    assert figures["zones"]["1"]["distance_mean"] == pytest.approx(0.2)
    assert {zone: row["trials"] for zone, row in figures["zones"].items()} == {
        "1": 2,
        "2": 1,
        "3": 1,
    }
    assert figures["transitions"]["right"][0] == [1, 0, 3, 0]
    (tmp_path / FILE).write_text(json.dumps(figures))
    runs = ["a/walk", "b/left", "c/right", "d/<sit>"]
    page = TransitionsSection().html(Run(tmp_path, {"config": {"actuation": {"runs": runs}}}))
    assert page is not None
    assert "0.75" in page  # three of four changes from walk on the right
    assert "&lt;sit&gt;" in page
    assert TransitionsSection().html(Run(tmp_path / "nothing", {"config": {}})) is None


@pytest.mark.parametrize(
    "words", [["trials", "sitting/meta"], ["kinematics"], ["room", "sitting/meta", "room.mp4"]]
)
@pytest.mark.parametrize("trials", ["0", "1000000000000"])
def test_trials_that_cannot_be_are_refused(
    words: list[str],
    trials: str,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["sitting", *words, "--trials", trials]) == 2
    assert f"--trials={trials} is not possible" in capsys.readouterr().err


def test_stepping_back_goes_back() -> None:
    clip = generated_step_back(speed=0.6, cycle=1.2)
    assert clip.loop
    assert (clip.times.diff() > 0).all()
    moved = clip.root_position[-1] - clip.root_position[0]
    assert moved.tolist() == pytest.approx([-0.72, 0.0, 0.0], abs=1e-3)
    assert clip.root_position[0, 0].item() == pytest.approx(0.0)


def test_the_whole_motion_has_no_jump() -> None:
    """Ahead, half a turn, and down; nothing faster than its parts are."""
    clip = generated_whole()
    assert float(clip.root_position[:, :2].diff(dim=0).norm(dim=1).max()) * 60 < 1.6
    assert float(clip.root_position[0, 2] - clip.root_position[-1, 2]) > 0.25
    turned = clip.rotations[1:] * clip.rotations[:-1]
    assert float(turned.sum(dim=2).abs().min()) > 0.985  # less than 20 degrees a frame


def test_a_clip_that_is_only_played_comes_to_the_chair_that_stands_where_it_sits() -> None:
    built = build("experiment=sitting/whole", "num_worlds=2", "initial_states.span=[0,0]")
    built.environment.reset()
    assert minimum_distances(built).tolist() == pytest.approx([0.15, 0.15], abs=0.03)
    away = build("experiment=sitting/whole", "num_worlds=64", "initial_states=sitting/around_chair")
    away.environment.reset()
    nearest = minimum_distances(away)
    begins = away.environment.table["seat_distance"]
    assert (nearest <= begins + 1e-4).all()
    assert 0.3 < float(nearest.mean()) < 1.3


class Still:
    """An environment of two worlds: the first's episode ends after a decision, and then comes nearer."""

    num_worlds, device, decision, control_dt = 2, torch.device("cpu"), 1, 0.5
    observations: ClassVar = {}
    on_period = None

    def __init__(self) -> None:
        self.step = 0
        self.table = {
            n: torch.zeros(2)
            for n in ("zone", "side", "switch", "seated_seconds", "contact_seconds")
        }

    def reset(self, seed: int, draw: str) -> None:
        self.table["seat_distance"] = torch.tensor([2.0, 2.0])

    def advance(self, action: object) -> object:
        self.step += 1
        self.table["seat_distance"] = torch.tensor([2.0, 2.0]) / self.step
        self.table["seated_seconds"] = torch.full((2,), float(self.step))
        return SimpleNamespace(ended=torch.tensor([self.step == 1, False]))


def test_what_comes_after_an_episode_does_not_count() -> None:
    root = SimpleNamespace(seed=0, evaluation=SimpleNamespace(seconds=2.0))
    actuation = SimpleNamespace(options=SimpleNamespace(runs=("walk",)))
    experiment: Any = SimpleNamespace(root=root, need=lambda slot: actuation)
    action = SimpleNamespace(mode=lambda: None)
    policy: Any = SimpleNamespace(distribution=lambda observations: action)
    environment: Any = Still()
    found, counts = _carry_out(environment, policy, experiment)
    assert found["distance"].tolist() == [2.0, 0.5]
    assert found["seated"].tolist() == [1.0, 4.0]
    assert int(counts.sum()) == 3
