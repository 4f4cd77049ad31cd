"""The command line's retargeting."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from motion_files import walker

from understudy.command import cli
from understudy.setup import plugins
from understudy_motion.reading import read_clip
from understudy_motion.writers.table import NpzWriter


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
