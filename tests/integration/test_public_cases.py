"""Every failing input of public reports gives the right value that its ``case.md`` states."""

from __future__ import annotations

import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
import torch
from cases import CASES, needs_cases
from worlds import child_environment

from understudy.command.cli import main
from understudy.setup.plugins import installed
from understudy_characters.scene import CharacterScene
from understudy_motion.clip import angle_names
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.reading import ReadOptions, read_clip

pytestmark = needs_cases

REGISTRY = installed().registry
#: BVH whose joints are where those of the reference are.
SAME_MOTION = (
    "bvh-static-node-above-hips", "bvh-bones-in-position-channels", "bvh-joint-positions-all-zero",
    "bvh-cmu-unit", "bvh-utf16", "bvh-comment-first", "bvh-end-site-named", "bvh-end-effector",
    "bvh-duplicate-names", "bvh-duplicate-ends",
)  # fmt: skip
#: Files that are read once one option is given, or none: 6 frames at 30 Hz.
READ = {
    "bvh-frame-time-0/input.bvh": ("--source-rate", "30"),
    "bvh-frame-time-absent/input.bvh": ("--source-rate", "30"),
    "csv-pandas/input.csv": (),
    "smpl-poses-3d/input.npz": (),
    "smpl-whole-numbers/int.npz": (),
    "smpl-whole-numbers/object.npz": (),
    "robot-table-without-header/input.csv": (),
}
NAMES = {
    "cli-value-parentheses": "clip (1).bvh", "cli-value-umlaut": "läufer.bvh",
    "cli-value-equals": "epoch=9.bvh", "cli-value-hash": "take#2.bvh",
}  # fmt: skip
MODELS = (
    "mjcf-hinges-of-one-body-apart/robot.xml", "mjcf-prop-before-robot/robot.xml",
    "mjcf-name-taken-material/robot.xml", "mjcf-name-taken-box/robot.xml",
    "mjcf-name-taken-plane-in-body/robot.xml", "mjcf-nested-include/robot.xml",
    "mjcf-meshes-beside-folder//mjcf/robot.xml", "mjcf-suffix/ROBOT.XML", "mjcf-suffix/robot.mjcf",
    "mjcf-latin1/robot.xml", "mjcf-no-gravity/robot.xml",
)  # fmt: skip
SCRIPTS = (
    "retarget-zero-pose-is-no-stance-x", "retarget-zero-pose-is-no-stance-legs",
    "gym-async-fork", "gym-pickle-deepcopy",
)  # fmt: skip
SHELL = ("fs-without-flock", "stdout-not-utf8")


def test_all_are_tried() -> None:
    files = {file.split("/")[0] for file in (*READ, *MODELS)}
    tried = {*SAME_MOTION, *NAMES, *SCRIPTS, *SHELL, *files}
    assert tried == {folder.name for folder in CASES.iterdir() if folder.is_dir()}
    assert len(tried) == 36


@pytest.mark.parametrize("case", SAME_MOTION)
def test_the_same_motion(case: str) -> None:
    (file,) = (f for f in (CASES / case).glob("*.bvh") if f.name != "reference.bvh")
    found = read_clip(file, REGISTRY, ReadOptions())
    wanted = read_clip(CASES / "bvh-utf16" / "reference.bvh", REGISTRY, ReadOptions())
    assert (found.num_frames, len(found.joint_names)) == (6, len(wanted.joint_names))
    assert found.frame_rate == pytest.approx(wanted.frame_rate)
    places, rotations = (forward_kinematics(c) for c in (found, wanted))
    torch.testing.assert_close(places[0], rotations[0], atol=1e-4, rtol=0)
    torch.testing.assert_close(places[1], rotations[1], atol=1e-4, rtol=0)


@pytest.mark.parametrize("file", READ)
def test_read(file: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["motion", "check", f"{CASES}/{file}", *READ[file]]) in (0, 1)
    assert "0.17 s, 6 frames at 30 frames/s" in capsys.readouterr().out
    if file.startswith("robot"):
        clip = read_clip(CASES / file, REGISTRY, ReadOptions())
        assert len(angle_names(clip) or ()) == 29
        assert clip.root_position[1].tolist() == [0.04, 0.0, 0.9]
        assert clip.rotations[:, 0].tolist() == [[1.0, 0.0, 0.0, 0.0]] * 6


@pytest.mark.parametrize("case", NAMES)
def test_names_of_files(
    case: str, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(CASES / case)
    assert main(["config", "experiment=spacetime/walk", f"motion.file={NAMES[case]}"]) == 0
    (line,) = (w for w in capsys.readouterr().out.splitlines() if w.startswith("motion.file:"))
    assert line.startswith(f'motion.file: "{NAMES[case]}"  ')


@pytest.mark.parametrize("file", MODELS)
def test_models(file: str) -> None:
    found = CharacterScene(CharacterScene.Options(f"{CASES}/{file}"))
    model = found.model
    assert found.character.joint_names[0] == "pelvis"
    assert (len(found.character.joints), model.nu) == (13, 23)
    still = [g for g in range(model.ngeom) if model.body_weldid[model.geom_bodyid[g]] == 0]
    assert [model.geom(g).name for g in still if model.geom_contype[g]] == ["floor"]


@pytest.mark.slow
@pytest.mark.parametrize("case", SCRIPTS)
def test_scripts(case: str) -> None:
    own = {
        k: v for k, v in os.environ.items() if k != "OMP_NUM_THREADS"
    }  # torch's threads are there
    done = subprocess.run(
        [sys.executable, f"{CASES}/{case}/check.py"],
        capture_output=True, text=True, check=False, timeout=240, env=own,
    )  # fmt: skip
    assert done.returncode == 0, done.stderr
    angles = [float(a) for a in re.findall(r"([\d.]+) degrees", done.stdout)]
    assert len(angles) == (13 if case.startswith("retarget") else 0)
    assert all(a < 10.0 for a in angles), done.stdout


@pytest.mark.slow
@pytest.mark.parametrize("case", SHELL)
def test_other_systems(case: str, tmp_path: Path) -> None:
    """As the case's ``run.sh`` says."""
    for file in (CASES / case).iterdir():
        (tmp_path / file.name).write_bytes(file.read_bytes())
    programs = f"{Path(sys.executable).parent}{os.pathsep}{os.environ['PATH']}"
    done = subprocess.run(
        ["sh", "run.sh"], cwd=tmp_path, capture_output=True, text=True, check=False, timeout=240,
        env={**child_environment(), "PATH": programs},
    )  # fmt: skip
    assert "Traceback" not in done.stdout + done.stderr
    assert "UnicodeEncodeError" not in done.stdout + done.stderr
    if case == "fs-without-flock":
        assert shlex.split(done.stdout)[-1] == "0", done.stderr
