"""How plays of what ships are cut into episodes before they are checked."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import shipped

from understudy.setup.plugins import installed
from understudy_characters.character import load_character


def standing(frames: int, x: float = 0.0, turned: float = 0.0) -> np.ndarray:
    root = [x, 0.0, 0.9, np.cos(turned / 2), np.sin(turned / 2), 0.0, 0.0]
    return np.tile(np.array([*root, 0.1]), (frames, 1))


def test_a_figure_that_is_moved_begins_another_episode() -> None:
    walked = standing(4)
    walked[:, 0] = np.linspace(0.0, 0.6, 4)  # 6 m/s is no restart
    parts = shipped.episodes(np.concatenate([walked, standing(3, x=1.0), standing(2, 1.0, 2.0)]))
    assert [len(part) for part in parts] == [4, 3, 2]


def test_the_other_sign_of_a_rotation_is_the_same_episode() -> None:
    turning = standing(6, turned=0.4)
    turning[3:, 3:7] *= -1
    assert len(shipped.episodes(turning)) == 1


def test_who_is_put_back_has_not_slid() -> None:
    character = load_character("humanoid", installed().registry)
    stands = np.tile(character.model.qpos0, (6, 1))
    stands[:, 2] -= 0.01  # the floor carries it
    alone = shipped.measured(stands, 1 / 30, character)
    back = np.concatenate(
        [stands, stands + np.eye(1, stands.shape[1])]
    )  # a metre on, standing again
    assert shipped.measured(back, 1 / 30, character) == alone
    assert alone["slide"] == 0.0
    moved = np.concatenate([stands, stands + 0.1 * np.eye(1, stands.shape[1])])
    assert shipped.measured(moved, 1 / 30, character)["slide"] > 0.1, "within an episode it has"
