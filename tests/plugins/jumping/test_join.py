"""A run-up and its jump become one file, from the command line; nothing is trained."""

from __future__ import annotations

import json
import re
import shutil
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import trimesh

from understudy.command.cli import main
from understudy.errors import FileError
from understudy.records import runs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_characters.recording import recorded_clips, recorded_scene
from understudy_characters.scene import CharacterScene
from understudy_jumping.join import _figures, joined
from understudy_motion.editing import evenly_spaced
from understudy_motion.reading import read_clip

#: Of the jump, four frames: a box 0.6 m high and 0.5 m wide; the mat behind it rises.
ARENA = {
    "obstacle_height": np.full(4, 0.6),
    "obstacle_width": np.full(4, 0.5),
    "mat_height": np.array([0.1, 0.2, 0.3, 0.4]),
}


def recorded_run(
    folder: Path, task: str, frames: int, rate: float = 60.0, **fields: np.ndarray
) -> Path:
    """A run folder whose recording has an athlete that moves 0.1 m a frame."""
    words = [f"task={task}", "num_worlds=2", f"run.dir={folder}"]
    runs.create(load_experiment(words), words, {}).unlock()
    # as on a machine that lacks what it was trained with
    info = json.loads((folder / "run.json").read_text())
    info["config"]["simulator"] = {"name": "elsewhere"}
    (folder / "run.json").write_text(json.dumps(info))
    scene = recorded_scene(runs.open_run(folder))
    assert isinstance(scene, CharacterScene)
    qpos = np.tile(scene.model.qpos0, (frames, 1))
    qpos[:, scene.layout.root_address] = 0.1 * np.arange(frames)
    arrays: dict[str, Any] = {
        "control_dt": 1 / rate,
        "first_episode": frames,
        "qpos": qpos,
        **fields,
    }
    np.savez(folder / "recording.npz", **arrays)
    return folder


@pytest.fixture(scope="module")
def run_up(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("join") / "run_up", "jumping/run_up", 10)


@pytest.fixture(scope="module")
def jump(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return recorded_run(tmp_path_factory.mktemp("join") / "jump", "jumping/obstacle", 4, **ARENA)


def test_obstacle_and_mat_are_in_the_file(
    run_up: Path, jump: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if "glb" not in installed().registry.names("clip_writer"):
        pytest.skip("no plugin here writes .glb")
    file = tmp_path / "whole.glb"
    assert main(["jumping", "join", str(run_up), str(jump), str(file)]) == 0
    assert "0.22 s, taken off at 0.17 s" in capsys.readouterr().out
    figure, *around = trimesh.load_scene(file).geometry.values()  # y up, facing z
    assert 1.5 < figure.extents[1] < 2.0
    extents = sorted(thing.extents[[2, 0, 1]].tolist() for thing in around)
    np.testing.assert_allclose(extents, [[0.5, 8.0, 0.6], [5.0, 8.0, 0.8]], atol=1e-6)


@pytest.mark.parametrize("ending", ["npz", "bvh"])
def test_the_figure_alone_where_the_file_holds_one_motion(
    run_up: Path, jump: Path, tmp_path: Path, ending: str
) -> None:
    file = tmp_path / f"whole.{ending}"
    assert main(["jumping", "join", str(run_up), str(jump), str(file)]) == 0
    assert file.stat().st_size > 1000


def test_the_file_says_on_what_terms_both_runs_may_be_used(jump: Path, tmp_path: Path) -> None:
    run_up = recorded_run(tmp_path / "run_up", "jumping/run_up", 10)
    info = json.loads((run_up / "run.json").read_text())
    info["sources"] = {
        "motion": {"clip": "sprint", "licence": "CC BY 4.0", "attribution": "Sprinted by Ada."}
    }
    (run_up / "run.json").write_text(json.dumps(info))
    file = tmp_path / "whole.npz"
    assert main(["jumping", "join", str(run_up), str(jump), str(file)]) == 0
    clip = read_clip(file, installed().registry)
    assert clip.licence == ("CC BY 4.0 (clip sprint) AND Apache-2.0 (model jumper) AND Apache-2.0")
    assert clip.attribution.startswith("Sprinted by Ada. Commercial use: nothing stands in the way")


def test_they_wait_for_the_jump(run_up: Path, jump: Path) -> None:
    whole = joined(recorded_clips(run_up)[0], recorded_clips(jump)[0])
    figure, *around = _figures(whole, str(jump), Path("whole.GLB"))
    assert figure.clip is whole
    assert {shape.joint for shape in figure.shapes} <= set(whole.joint_names)
    for thing in around:
        np.testing.assert_array_equal(thing.clip.times, whole.times)
        assert thing.clip.rotations.shape == (14, 1, 4)
    at = {thing.clip.name: thing.clip.root_position.numpy() for thing in around}
    np.testing.assert_allclose(at["obstacle"], np.tile([0.25, 0.0, 0.3], (14, 1)))
    np.testing.assert_allclose(at["mat"][:, 2], [*10 * [0.1], *ARENA["mat_height"]])


@pytest.mark.parametrize(("slow", "fast"), [(30.0, 60.0), (60.0, 30.0), (25.0, 60.0)])
def test_of_two_rates_the_motion_has_the_finer_one_throughout(
    slow: float, fast: float, tmp_path: Path
) -> None:
    run_up = recorded_run(tmp_path / "run_up", "jumping/run_up", 10, slow)
    jump = recorded_run(tmp_path / "jump", "jumping/obstacle", 4, fast, **ARENA)
    first, second = recorded_clips(run_up)[0], recorded_clips(jump)[0]
    whole = joined(first, second)
    lasts = 10 / slow + 3 / fast
    assert whole.duration == pytest.approx(lasts)
    np.testing.assert_allclose(whole.times.diff(), whole.duration / round(lasts * 60))
    assert evenly_spaced(whole) is whole
    at = whole.times.numpy()
    run = -1.0 + 0.1 * slow * at  # to x = 0, where the jump begins
    np.testing.assert_allclose(
        whole.root_position[:, 0],
        np.where(at < 10 / slow, run, 0.1 * fast * (at - 10 / slow)),
        atol=1e-3 + (0.05 if slow == 25 else 0),
    )
    figure, *around = _figures(whole, str(jump), Path("whole.glb"))
    assert figure.clip is whole
    (mat,) = (thing.clip for thing in around if thing.clip.name == "mat")
    np.testing.assert_array_equal(mat.times, whole.times)
    heights = np.interp(at - 10 / slow, np.arange(4) / fast, ARENA["mat_height"])
    np.testing.assert_allclose(mat.root_position[:, 2], heights, atol=1e-6)


def test_the_obstacle_is_in_the_video(
    run_up: Path, jump: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn: list[Mapping[str, Any]] = []
    monkeypatch.setattr(CharacterScene, "draw", lambda scene, tracks: tracks)
    monkeypatch.setattr(
        "understudy_jumping.join.write_video", lambda path, tracks, rate: drawn.append(tracks)
    )
    file = tmp_path / "whole.mp4"
    assert main(["jumping", "join", str(run_up), str(jump), str(file)]) == 0
    (tracks,) = drawn
    assert tracks.keys() == {"qpos", *ARENA}
    assert len(tracks["qpos"]) == 7  # of 0.22 s, at 30 Hz
    for name, recorded in ARENA.items():
        np.testing.assert_allclose(tracks[name], np.full(7, recorded[0]))


def test_runs_of_two_characters_are_refused_before_they_are_recorded(
    jump: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Skills are recorded for it, which took half a minute of each and left them with a report."""
    other = tmp_path / "other"
    words = ["task=sitting/walk", "num_worlds=2", f"run.dir={other}"]
    runs.create(load_experiment(words), words, {}).unlock()
    assert main(["jumping", "join", str(other), str(jump), str(tmp_path / "whole.npz")]) == 2
    assert f"{other} and {jump} are not of the same character" in capsys.readouterr().err
    assert not (tmp_path / "whole.npz").exists()


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("jump", "run_up"), "is a jump, and {1} is none: exchange them"),
        (("run_up", "run_up"), "{1} is no jump: its task has no obstacle"),
        (("jump", "jump"), "{0} is a jump itself: its task has an obstacle"),
    ],
)
def test_a_run_up_comes_first_and_a_jump_second(
    names: tuple[str, str], said: str, run_up: Path, jump: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """Exchanged, they were joined without a word."""
    given = [str({"run_up": run_up, "jump": jump}[name]) for name in names]
    assert main(["jumping", "join", *given, str(tmp_path / "whole.npz")]) == 2
    error = capsys.readouterr().err
    assert said.format(*given) in error
    assert error.count("\n") == 1
    assert not any(tmp_path.iterdir())


def test_a_run_that_was_rendered_by_other_words_says_where(jump: Path, tmp_path: Path) -> None:
    """As one that was trained on a GPU and is looked at without."""
    run = tmp_path / "run"
    shutil.copytree(jump, run)
    rendered = run / "renders" / "device-cpu"
    rendered.mkdir(parents=True)
    (run / "recording.npz").rename(rendered / "recording.npz")
    with pytest.raises(FileError, match=re.escape(f"by other words, such as {rendered}")):
        recorded_clips(run)
