"""Tables for other trainers, read back as those document them."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import torch
from robots import robot_file
from scipy.spatial.transform import Rotation

from understudy.command.cli import main
from understudy.setup.plugins import installed
from understudy_characters.character import Character, load_character
from understudy_export.columns import joint_columns
from understudy_motion.clip import Clip, resample
from understudy_motion.reading import read_clip
from understudy_motion.writers.table import NpzWriter


def moving(character: Character) -> Clip:
    """A second of all joints turning, each in its own way, while the root goes, turns and leans."""
    times = torch.arange(31, dtype=torch.float64) / 30
    qpos = torch.tensor(character.model.qpos0, dtype=torch.float64).repeat(31, 1)
    phase = torch.arange(qpos.shape[1] - 7, dtype=torch.float64)
    qpos[:, 7:] = 0.2 + 0.15 * torch.sin(6.0 * times[:, None] + phase)
    qpos[:, :3] += times[:, None] * torch.tensor([1.0, -0.5, 0.2], dtype=torch.float64)
    turns = Rotation.from_euler("xyz", np.outer(times, [0.3, -0.4, 2.0])).as_quat(scalar_first=True)
    qpos[:, 3:7] = torch.from_numpy(turns)
    return character.clip(qpos, times, name="moving", licence="CC0")


def as_mjlab_reads(path: Path) -> np.ndarray:
    """``qpos`` (F, 7 + J) by ``MotionLoader`` of ``mjlab.scripts.csv_to_npz``."""
    rows = np.loadtxt(path, delimiter=",")
    return np.concatenate([rows[:, :3], rows[:, 3:7][:, [3, 0, 1, 2]], rows[:, 7:]], axis=1)


def as_protomotions_reads(path: Path) -> np.ndarray:
    """``qpos`` (F, 7 + J) by ``convert_g1_csv_to_proto.py`` with its defaults."""
    rows = np.loadtxt(path, delimiter=",", skiprows=1)[:, 1:]
    xyzw = Rotation.from_euler("xyz", rows[:, 3:6], degrees=True).as_quat()
    return np.concatenate(
        [rows[:, :3] / 100.0, xyzw[:, [3, 0, 1, 2]], np.deg2rad(rows[:, 6:])], axis=1
    )


@pytest.mark.parametrize(
    ("trainer", "read"), [("mjlab", as_mjlab_reads), ("protomotions", as_protomotions_reads)]
)
def test_the_motion_comes_back(trainer: str, read: object, tmp_path: Path) -> None:
    robot = robot_file(tmp_path)
    character = load_character(str(robot), installed().registry)
    clip = moving(character)
    NpzWriter().write(resample(clip, 60.0), tmp_path / "moving.npz")
    out = tmp_path / "out.csv"
    arguments = ["motion", "export", str(tmp_path / "moving.npz"), str(robot), str(out)]
    assert main([*arguments, "--for", trainer]) == 0
    found = torch.from_numpy(read(out))  # type: ignore[operator]
    assert found.shape == (31, 7 + len(joint_columns(character)))
    again = character.clip(found, clip.times, name="again")
    dot = (again.rotations * clip.rotations).sum(-1).abs()
    assert dot.min() > 1.0 - 1e-6
    torch.testing.assert_close(again.root_position, clip.root_position, atol=1e-5, rtol=0.0)


@pytest.mark.parametrize("trainer", ["mjlab", "protomotions"])
@pytest.mark.parametrize("before", [True, False])
def test_what_is_written_is_read_back(trainer: str, before: bool, tmp_path: Path) -> None:
    """Also where a free ball stands before or behind the robot in its file."""
    robot = robot_file(tmp_path)
    ball = '<body name="ball" pos="2 0 1"><freejoint/><geom size=".1"/></body>'
    where = (
        ("<worldbody>", "<worldbody>" + ball) if before else ("</worldbody>", ball + "</worldbody>")
    )
    plain = load_character(str(robot), installed().registry)
    clip = moving(plain)
    robot.write_text(robot.read_text().replace(*where, 1))
    character = load_character(str(robot), installed().registry)
    NpzWriter().write(clip, tmp_path / "moving.npz")
    out = tmp_path / "out.csv"
    arguments = ["motion", "export", str(tmp_path / "moving.npz"), str(robot), str(out)]
    assert main([*arguments, "--for", trainer]) == 0
    again = character.posed(read_clip(out, installed().registry))
    torch.testing.assert_close(again.times, clip.times)
    torch.testing.assert_close(again.root_position, clip.root_position, atol=1e-5, rtol=0.0)
    assert (again.rotations * clip.rotations).sum(-1).abs().min() > 1.0 - 1e-6
    torch.testing.assert_close(character.qpos(again), character.qpos(clip), atol=1e-5, rtol=0.0)


def test_columns_are_named_in_the_order_of_the_model(tmp_path: Path) -> None:
    robot = robot_file(tmp_path)
    character = load_character(str(robot), installed().registry)
    NpzWriter().write(moving(character), tmp_path / "moving.npz")
    out = tmp_path / "out.csv"
    arguments = ["motion", "export", str(tmp_path / "moving.npz"), str(robot), str(out)]
    assert main([*arguments, "--for", "protomotions"]) == 0
    header = out.read_text().splitlines()[0].split(",")
    assert header[:7] == [
        "Frame", "root_translateX", "root_translateY", "root_translateZ",
        "root_rotateX", "root_rotateY", "root_rotateZ",
    ]  # fmt: skip
    assert header[7:] == [f"{name}_dof" for name in joint_columns(character)]
    assert header[7] == "left_hip_x_dof"


def test_balls_have_no_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.csv"
    assert main(["motion", "export", "walk", "humanoid", str(out), "--for", "mjlab"]) == 2
    assert "is no hinge" in capsys.readouterr().err
    assert not out.exists()


@pytest.mark.parametrize("command", [["motion", "export"], ["export"]])
@pytest.mark.parametrize(
    ("rate", "said"),
    [("0.001", "1000 s apart"), ("0.0333", "the rate is 30.03"), ("1e6", "so often"), ("0", "above 0")],
)  # fmt: skip
def test_what_is_no_rate_is_refused(
    command: list[str], rate: str, said: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A table of one frame came of it, and nothing was said."""
    out = str(tmp_path / "out.csv")
    words = ["humanoid", out, "--for", "mjlab"] if command[0] == "motion" else [out]
    assert main([*command, "walk", *words, f"--rate={rate}"]) == 2
    assert said in capsys.readouterr().err
    assert not any(tmp_path.iterdir())


def test_a_cycle_of_one_pose_is_refused(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    out = tmp_path / "out.bvh"
    assert main(["export", "walk", str(out), "--rate=1"]) == 2
    assert "a cycle of 1.05 s at 1 Hz is one pose" in capsys.readouterr().err
    assert not out.exists()
    assert main(["export", "walk", str(out), "--rate=2"]) == 0
    assert "Frames: 3" in out.read_text()
