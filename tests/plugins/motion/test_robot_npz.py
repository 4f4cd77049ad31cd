"""Robots' motions as NPZ: root and angles come out as they went in."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from robots import robot_xml

from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_motion.reading import ReadOptions, UnknownFormatError, read_clip

REGISTRY = installed().registry
FRAMES = 20


@pytest.fixture(scope="module")
def character(tmp_path_factory: pytest.TempPathFactory) -> Character:
    path = tmp_path_factory.mktemp("robot") / "robot.xml"
    path.write_text(robot_xml())
    return load_character(str(path), REGISTRY)


@pytest.fixture(scope="module")
def qpos(character: Character) -> np.ndarray:
    """(F, nq): the robot going and turning while every hinge swings in its own way."""
    time = np.arange(FRAMES) / 30.0
    found = np.tile(character.model.qpos0, (FRAMES, 1))
    found[:, 0] += time
    found[:, 3], found[:, 6] = np.cos(time), np.sin(time)
    found[:, 7:] = 0.3 * np.sin(3.0 * time[:, None] + np.arange(found.shape[1] - 7))
    return found


def check(
    path: Path, character: Character, wanted: np.ndarray, frames: float, **options: Any
) -> None:
    clip = read_clip(path, REGISTRY, ReadOptions(**options))
    assert clip.frame_rate == pytest.approx(frames)
    torch.testing.assert_close(
        character.qpos(clip), torch.from_numpy(wanted), atol=1e-5, rtol=0, check_dtype=False
    )


@pytest.mark.parametrize(
    "names",
    [
        ("root_pos", "root_rot", "dof_pos", "fps"),
        ("root_trans_offset", "root_rot", "dof", "fps"),
        ("root_trans", "root_quat", "dofs", "motion_fps"),
        ("root_position", "root_orientation", "joint_pos", "frame_rate"),
    ],
)
@pytest.mark.parametrize("scalar_first", [False, True])
@pytest.mark.parametrize("kind", ["<f8", ">f4"])
def test_root_and_angles(
    tmp_path: Path,
    character: Character,
    qpos: np.ndarray,
    names: tuple[str, ...],
    scalar_first: bool,
    kind: str,
) -> None:
    turn = qpos[:, 3:7] if scalar_first else qpos[:, [4, 5, 6, 3]]
    arrays = [
        qpos[:, :3].astype(kind),
        np.asfortranarray(turn.astype(kind)),
        qpos[:, 7:].astype(kind),
    ]
    given: dict[str, Any] = dict(zip(names, [*arrays, 50], strict=True))
    np.savez(tmp_path / "x.npz", **given)
    check(tmp_path / "x.npz", character, qpos, 50.0)


def test_qpos_is_wxyz_also_where_the_root_lies(
    tmp_path: Path, character: Character, qpos: np.ndarray
) -> None:
    half = 0.5**0.5
    lying = qpos.copy()
    lying[:, 3:7] = [half, 0.0, half, 0.0]
    np.savez(tmp_path / "x.npz", qpos=lying, qvel=lying[:, 1:], frequency=np.array([100.0]))
    check(tmp_path / "x.npz", character, lying, 100.0)
    check(tmp_path / "x.npz", character, lying, 25.0, rate=25.0)


@pytest.mark.parametrize("root", [(), ("root",)])
def test_names_say_which_hinge_is_which(
    tmp_path: Path, character: Character, qpos: np.ndarray, root: tuple[str, ...]
) -> None:
    order = np.arange(len(character.hinges))[::-1]
    names = [f"{list(character.hinges)[n]}_joint" for n in order]
    turned = np.concatenate((qpos[:, :7], qpos[:, 7:][:, order]), axis=1)
    np.savez(tmp_path / "x.npz", qpos=turned, joint_names=[*root, *names], frequency=30)
    check(tmp_path / "x.npz", character, qpos, 30.0)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"fps": None}, "does not say its frame rate; give motion.rate"),
        ({"fps": 0.02}, "'fps' is 0.02, and frames would be 50 s apart"),
        ({"fps": -1}, "'fps' is -1, and frames per second are above 0"),
        ({"root_rot": np.ones((FRAMES, 4))}, "no quaternion"),
        ({"root_rot": np.full((FRAMES, 4), 1e308)}, "frame 0: a number is beyond"),
        ({"root_rot": np.ones((FRAMES - 1, 4))}, "'root_rot': its shape"),
        ({"dof_pos": np.full((FRAMES, 21), 40.0)}, "seem to be in degrees"),
        ({"root_pos": np.full((FRAMES, 3), 80.0)}, "80 m from the floor"),
        ({"joint_names": np.array(["a", "a"])}, "21 angles, and 1 names of them in 'joint_names'"),
        ({"qpos": np.zeros((FRAMES, 5))}, "its qpos has 5 numbers a frame"),
        ({"dof_pos": np.array([{}] * FRAMES)}, "objects|object where"),
    ],
)
def test_what_is_wrong_is_named(
    tmp_path: Path, qpos: np.ndarray, change: dict[str, Any], said: str
) -> None:
    given = {
        "root_pos": qpos[:, :3],
        "root_rot": qpos[:, [4, 5, 6, 3]],
        "dof_pos": qpos[:, 7:],
        "fps": 30,
    }
    given = {name: value for name, value in {**given, **change}.items() if value is not None}
    np.savez(tmp_path / "x.npz", **given)
    with pytest.raises(FileError, match=said):
        read_clip(tmp_path / "x.npz", REGISTRY)


def test_what_has_no_root_or_another_order_says_what_to_save(tmp_path: Path) -> None:
    """Isaac Lab's order of hinges is its own."""
    bodies: dict[str, Any] = {
        "body_pos_w": np.zeros((9, 30, 3)),
        "body_quat_w": np.zeros((9, 30, 4)),
    }
    np.savez(tmp_path / "x.npz", joint_pos=np.zeros((9, 29)), fps=[50], **bodies)
    with pytest.raises(
        UnknownFormatError, match=r"root_pos, root_rot \(xyzw\), dof_pos, in the order of its model"
    ):
        read_clip(tmp_path / "x.npz", REGISTRY)
