"""A run that was recorded with a chair becomes a file with figure and chair."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
import trimesh
from sitting_tasks import build

from understudy.command.cli import main
from understudy.setup.building import Built
from understudy_characters.recording import recorded_clips, recorded_surroundings
from understudy_characters.scene import CharacterScene

TINY = (
    "num_worlds=2", "learner.rollout_steps=64", "learner.minibatches=2", "budget.samples=128",
    "evaluation.episodes=2", "evaluation.final_episodes=2", "evaluation.seconds=0.1",
)  # fmt: skip


def test_the_chair_is_where_it_was_recorded_and_as_large(sit: Built) -> None:
    scene = sit.scene
    assert isinstance(scene, CharacterScene)
    qpos = np.tile(scene.model.qpos0, (3, 1))
    places = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, 0.0], [1.0, 3.0, 0.0]])
    half_turn = np.tile([0.0, 0.0, 0.0, 1.0], (3, 1))
    size = np.tile([0.3, 0.25, 0.025], (3, 1))
    tracks = {
        "qpos": qpos, "chair_position": places, "chair_rotation": half_turn,
        "geom_size/chair_seat": size,
    }  # fmt: skip
    (chair,) = scene.surroundings(tracks)
    assert chair.name == "chair"
    np.testing.assert_allclose(chair.positions, places)
    np.testing.assert_allclose(np.abs(chair.rotations), half_turn, atol=1e-12)
    seat = chair.shapes[0].vertices
    np.testing.assert_allclose(seat.max(axis=0), [0.3, 0.25, 0.45], atol=1e-9)


def test_a_task_without_surroundings_has_none() -> None:
    built = build("experiment=sitting/walk", "num_worlds=2")
    assert isinstance(built.scene, CharacterScene)
    assert list(built.scene.surroundings({"qpos": np.zeros((2, 28))})) == []


def test_figure_and_chair_in_one_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    run = tmp_path / "run"
    assert main(["train", "experiment=sitting/sit", *TINY, f"run.dir={run}"]) == 0
    learned, _ = recorded_clips(run)
    (chair,) = recorded_surroundings(run)
    assert torch.equal(chair.clip.times, learned.times)
    assert main(["export", str(run), str(tmp_path / "out.glb")]) == 0
    assert "without" not in capsys.readouterr().out
    assert main(["export", str(run), str(tmp_path / "out.bvh")]) == 0  # the figure alone
    said = capsys.readouterr().out
    assert "without 1 other body of the scene, which .glb and .gltf files have" in said
    scene = trimesh.load_scene(tmp_path / "out.glb")  # y up, facing z
    figure, seen = scene.geometry.values()
    width, height, depth = seen.extents
    assert width == pytest.approx(0.46, abs=1e-3)
    assert height == pytest.approx(0.9, abs=1e-3)
    assert depth == pytest.approx(0.42 + 0.05, abs=1e-3)
    assert 1.5 < figure.extents[1] < 1.75
