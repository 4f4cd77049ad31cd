"""The command line's retargeting."""

from __future__ import annotations

import json
import shlex
from dataclasses import replace
from pathlib import Path

import pytest
import torch
from motion_files import walker
from robots import robot_file

from understudy.command import cli
from understudy.setup import plugins
from understudy_characters.character import load_character
from understudy_motion import library
from understudy_motion.reading import read_clip
from understudy_motion.writers.table import NpzWriter
from understudy_retarget.retarget import retarget

ONE_ITERATION = [
    "num_worlds=2", "budget.samples=8", "learner.rollout_steps=4", "learner.batch_size=4",
    "learner.minibatches=null", "learner.epochs=1", "evaluation.seconds=0.1",
    "evaluation.episodes=2", "evaluation.final_episodes=2", "run.video_seconds=0",
]  # fmt: skip


def run(capsys: pytest.CaptureFixture[str], *arguments: object) -> tuple[int, str, str]:
    status = cli.main(["motion", "retarget", *map(str, arguments)])
    shown = capsys.readouterr()
    return status, shown.out, shown.err


def test_a_clip_is_written_and_told_about(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    out = tmp_path / "walk.npz"
    status, shown, _ = run(capsys, "walk", "jumper", out)
    assert status == 0
    for expected in ("left_knee", "Key points", "rad/s", f"understudy motion check {out}", f"motion.file={out}"):  # fmt: skip
        assert expected in shown
    clip = read_clip(out, plugins.installed().registry)
    assert clip.joint_names[0] == "root"
    assert clip.loop


@pytest.mark.parametrize("ending", ["bvh", "csv"])
def test_the_ending_says_the_format(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, ending: str
) -> None:
    out = tmp_path / f"walk.{ending}"
    assert run(capsys, "walk", "humanoid", out)[0] == 0
    assert read_clip(out, plugins.installed().registry).num_frames > 10


def test_the_report_as_json(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    status, shown, _ = run(capsys, "walk", "jumper", tmp_path / "x.npz", "--json", "--start", 0.2, "--end", 0.8)  # fmt: skip
    assert status == 0
    report = json.loads(shown)
    assert report["mapping"]["left_knee"] == ["left_knee", "left_knee"]
    assert 0 < report["key_point_error_m"]["mean"] < report["key_point_error_m"]["worst"] < 0.1
    clip = read_clip(tmp_path / "x.npz", plugins.installed().registry)
    assert clip.duration == pytest.approx(0.6)
    assert not clip.loop


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["nothing", "humanoid", "x.npz"], "No motion clip 'nothing'"),
        (["nothing.bvh", "humanoid", "x.npz"], "no such file"),
        (["walk", "humanoit", "x.npz"], "Did you mean 'humanoid'"),
        (["walk", "humanoid", "x.fbx"], "no format is written to '.fbx'"),
        (["walk", "humanoid", "no/folder/x.npz"], "cannot be written"),
        (["walk", "humanoid", "x.npz", "--map", "left_knee"], "OURS=THEIRS"),
        (["walk", "humanoid", "x.npz", "--map", "left_knee=none"], "no joint 'none'"),
        (["walk", "humanoid", "x.npz", "--scale", "0"], "a number above 0"),
        (["walk", "humanoid", "x.npz", "--start", "5"], "cannot be cut"),
    ],
)
def test_what_the_user_can_get_wrong(
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    arguments: list[str],
    reason: str,
) -> None:
    monkeypatch.chdir(tmp_path)
    status, _, error = run(capsys, *arguments)
    assert status == 2
    assert reason in error
    assert error.count("\n") == 1
    assert not list(tmp_path.iterdir())


def test_names_are_given_where_they_say_nothing(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    file = tmp_path / "walker.npz"
    NpzWriter().write(walker(), file)
    status, _, error = run(capsys, file, "humanoid", tmp_path / "out.npz")
    assert status == 2
    assert "--map" in error


def test_clips_are_checked_before_they_are_retargeted(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    NpzWriter().write(library.find("walk", plugins.installed().registry), tmp_path / "whole.npz")
    _, _, err = run(capsys, tmp_path / "whole.npz", "humanoid", tmp_path / "a.npz")
    assert err == ""
    walk = library.find("walk", plugins.installed().registry)
    turned = walk.rotations.clone()
    turned[30, 2] = torch.tensor([0.7071, 0.0, 0.0, 0.7071])
    NpzWriter().write(replace(walk, rotations=turned), tmp_path / "broken.npz")
    status, _, err = run(capsys, tmp_path / "broken.npz", "humanoid", tmp_path / "b.npz")
    assert status == 0
    assert "major: spike" in err


def test_the_result_has_its_own_title(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    run(capsys, "walk", "jumper", tmp_path / "robot_walk.npz")
    assert read_clip(tmp_path / "robot_walk.npz", plugins.installed().registry).name == "robot_walk"


def test_one_step_below_the_floor_does_not_raise_the_rest(tmp_path: Path) -> None:
    """The floor is where feet stand, not the deepest point of the clip."""
    registry = plugins.installed().registry
    character, walk = load_character("humanoid", registry), library.find("walk", registry)
    low = walk.root_position.clone()
    low[:, 2] -= 0.08 * torch.exp(-(((walk.times - 0.5) / 0.02) ** 2))
    sunk, whole = (retarget(c, character)[0] for c in (replace(walk, root_position=low), walk))
    off = (sunk.root_position - whole.root_position)[:, 2]
    assert off[(walk.times - 0.5).abs() > 0.2].abs().max() < 0.01


@pytest.mark.parametrize("ending", ["npz", "csv", "bvh"])
def test_the_commands_at_the_end_can_be_carried_out(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, ending: str
) -> None:
    """On a robot of hinges, and as they are printed."""
    robot, out = robot_file(tmp_path), tmp_path / f"its walk.{ending}"
    shown = run(capsys, "walk", robot, out)[1]
    check, train = (line.partition("understudy ")[2] for line in shown.splitlines()[-2:])
    assert cli.main(shlex.split(check)) in (0, 1)
    assert cli.main([*shlex.split(train), *ONE_ITERATION, f"run.dir={tmp_path / 'run'}"]) == 0


def test_what_only_shows_is_not_to_be_checked(
    capsys: pytest.CaptureFixture[str], tmp_path: Path
) -> None:
    status, shown, _ = run(capsys, "walk", "jumper", tmp_path / "walk.glb")
    assert status == 0
    assert "motion check" not in shown
    assert shown.endswith("'.glb' files are only shown: to learn the clip, write .npz.\n")


@pytest.mark.parametrize("model", ["gymnasium", "g1"])
def test_known_robots_train_as_it_says(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, model: str
) -> None:
    if model == "gymnasium":
        assets = pytest.importorskip("gymnasium.envs.mujoco", reason="gymnasium is not installed")
        file = Path(assets.__path__[0]) / "assets" / "humanoid.xml"
    else:
        zoo = pytest.importorskip("mjlab", reason="mjlab, which has a G1, is not installed")
        file = Path(zoo.__path__[0]) / "asset_zoo/robots/unitree_g1/xmls/g1.xml"
    shown = run(capsys, "walk", file, tmp_path / "walk.npz")[1]
    train = shown.splitlines()[-1].partition("understudy ")[2]
    assert cli.main([*shlex.split(train), *ONE_ITERATION, f"run.dir={tmp_path / 'run'}"]) == 0
