"""A run carries its clip and its character: it can be moved, and what it read may be gone."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest
from robots import robot_file

from understudy.command.cli import main
from understudy.errors import RunError
from understudy.records import runs
from understudy.setup.plugins import installed
from understudy_characters.character import load_character
from understudy_characters.recording import run_character
from understudy_motion import library
from understudy_motion.reading import ReadOptions
from understudy_motion.writing import write_clip
from understudy_retarget.retarget import retarget

SMALL = [
    "experiment=spacetime/walk", "scene.character=robot.xml", "num_worlds=2", "budget.samples=8",
    "learner.rollout_steps=4", "learner.batch_size=4", "learner.minibatches=null", "learner.epochs=1", "evaluation.seconds=0.2",
    "evaluation.episodes=2", "evaluation.final_episodes=2", "run.video_seconds=0", "run.dir=run",
]  # fmt: skip


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with a run of a stranger's robot and clip, both named by relative paths, and both
    deleted since."""
    folder = tmp_path_factory.mktemp("carried")
    registry = installed().registry
    character = load_character(str(robot_file(folder)), registry)
    write_clip(
        retarget(library.find("walk", registry), character)[0], folder / "walk.npz", registry
    )
    (folder / "LICENSE").write_text("CC0 of somebody\n")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        assert main(["train", *SMALL, "motion.file=walk.npz"]) == 0
    for name in ("walk.npz", "robot.xml", "LICENSE"):
        (folder / name).unlink()
    return folder


@pytest.fixture
def moved(trained: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The run somewhere else, and another working folder."""
    run = tmp_path / "elsewhere" / "run"
    shutil.copytree(trained / "run", run)
    monkeypatch.chdir(tmp_path)
    return run


def test_a_moved_run_is_evaluated_resumed_and_drawn_without_its_originals(moved: Path) -> None:
    assert main(["evaluate", str(moved)]) == 0
    assert main(["resume", str(moved), "budget.samples=16"]) == 0
    assert runs.open_run(moved).metrics()[-1]["samples"] == 16
    assert run_character(moved).name == "robot"


def test_a_run_is_not_led_astray_by_a_clip_of_the_same_name(moved: Path, tmp_path: Path) -> None:
    (tmp_path / "walk.npz").write_text("another clip")
    assert main(["evaluate", str(moved)]) == 0


def test_resuming_with_another_clip_carries_that_one(moved: Path, tmp_path: Path) -> None:
    registry = installed().registry
    old = next(moved.glob("inputs/*/walk.npz"))
    clip = library.find(str(old), registry, ReadOptions())
    write_clip(clip, tmp_path / "second.npz", registry)
    assert main(["resume", str(moved), "motion.file=second.npz", "budget.samples=16"]) == 0
    (tmp_path / "second.npz").unlink()
    assert main(["evaluate", str(moved)]) == 0


@pytest.mark.parametrize("name", ["walk.npz", "robot.xml"])
def test_a_copy_that_was_tampered_with_is_refused(
    moved: Path, name: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file = next(moved.glob(f"inputs/*/{name}"))
    file.write_bytes(file.read_bytes() + b" ")
    for command in ("evaluate", "resume", "render"):
        assert main([command, str(moved)]) == 2
        assert "is not what the run was made with" in capsys.readouterr().err


def test_inputs_that_are_no_names_are_refused(moved: Path) -> None:
    info = json.loads((moved / "run.json").read_text())
    for inputs in ([], {"x": []}, {"x": {}}, {"x": {"a": 1}}, {"x": 3}):
        (moved / "run.json").write_text(json.dumps(info | {"inputs": inputs}))
        with pytest.raises(RunError, match="damaged"):
            runs.open_run(moved)
