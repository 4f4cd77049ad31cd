"""Controllers above finished skills, from training to what is judged and drawn of them.

One skill of a few samples stands for all: what it can do is no matter here.
"""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path

import pytest
import trimesh

from understudy.command.cli import main
from understudy.records import checkpoint, runs
from understudy.setup.plugins import installed
from understudy_characters import room_drawing
from understudy_sitting.trials import FILE, TransitionsSection

TINY = (
    "simulator=mujoco", "device=cpu", "learner.minibatches=1", "evaluation.episodes=2",
    "evaluation.final_episodes=2", "evaluation.seconds=1", "evaluation.criterion=null", "run.video_seconds=0",
)  # fmt: skip


@pytest.fixture(scope="module")
def skill(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("skills") / "walk"
    words = ("experiment=sitting/walk", *TINY, "num_worlds=4", "budget.samples=64")
    assert main(["train", *words, f"run.dir={folder}"]) == 0
    return folder


@pytest.fixture(scope="module", params=["sitting/meta", "sitting/in_order"])
def controller(
    request: pytest.FixtureRequest, skill: Path, tmp_path_factory: pytest.TempPathFactory
) -> Path:
    folder = tmp_path_factory.mktemp("controllers") / "run"
    three = f"actuation.runs=['{skill}','{skill}','{skill}']"
    words = (f"experiment={request.param}", *TINY, three, "num_worlds=4", "budget.samples=32")
    assert main(["train", *words, f"run.dir={folder}"]) == 0
    return folder


def test_trials_say_what_was_judged(controller: Path) -> None:
    zone = "initial_states.zone=2"
    assert main(["sitting", "trials", str(controller), "--trials", "5", zone]) == 0
    found = json.loads((controller / FILE).read_text())
    assert found["judged"] == {"overrides": [zone], "seed": 0, "samples": 32}
    assert found["zones"].keys() == {"2"}
    assert found["all"]["trials"] == 5
    assert found["all"]["success_rate"] == 0.0, "nobody sits for 3 s in 1 s"
    assert 0.5 < found["all"]["distance_mean"] < 2.5


def test_a_room_is_filmed(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(room_drawing, "_EVERY", 6)  # each frame has shadows of a whole room
    film = tmp_path / "room.mp4"
    words = ("--trials", "2", "evaluation.seconds=0.5")
    assert main(["sitting", "room", str(controller), str(film), *words]) == 0
    assert film.stat().st_size > 1000


TRIALS, ROOM = ("trials", "--trials", "2"), ("room", "room.mp4", "--trials", "2")
UNDRAWN = "understudy_sitting.room_command.write_video"
meta = pytest.mark.parametrize("controller", ["sitting/meta"], indirect=True)


def carry_out(command: tuple[str, ...], run: Path, *words: str) -> int:
    """Carry out `command` for `run`, in the test's own folder."""
    name, *options = command
    return main(["sitting", name, str(run), *options, "evaluation.seconds=1", *words])


@meta
@pytest.mark.parametrize(
    ("command", "change"),
    [
        (TRIALS, "actuation.runs=['{0}','{0}']"),
        (TRIALS, "policy.hidden=[7]"),
        (TRIALS, "policy.hidden=[]"),
        (ROOM, "actuation.runs=['{0}','{0}']"),
    ],
)
def test_a_configuration_that_the_policy_does_not_fit_is_refused(
    controller: Path, skill: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...], change: str,
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    assert carry_out(command, controller, change.format(skill)) == 2
    assert "does not fit this configuration: " in capsys.readouterr().err


@meta
@pytest.mark.parametrize("command", [TRIALS, ROOM])
def test_a_checkpoint_without_a_policy_is_refused(
    controller: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch, command: tuple[str, ...],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    run = shutil.copytree(controller, tmp_path / "run")
    for path in checkpoint.newest(run / "checkpoints"):
        state, about = checkpoint.load(path)
        del state["policy"]
        checkpoint.save(path, state, about)
    assert carry_out(command, run) == 2
    assert "is a run that learns no policy" in capsys.readouterr().err


@meta
def test_a_run_is_judged_with_the_files_that_it_carries(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The chair's mesh is gone from where it was."""
    monkeypatch.setattr(UNDRAWN, lambda *frames: None)
    mesh, run = tmp_path / "chair.ply", tmp_path / "run"
    trimesh.creation.box((0.4, 0.4, 0.45)).export(mesh)
    overrides = runs.open_run(controller).info["overrides"]
    words = [word for word in overrides if not word.startswith("run.dir")]
    assert main(["train", *words, f"chair.mesh='{mesh}'", f"run.dir={run}"]) == 0
    mesh.unlink()
    assert carry_out(TRIALS, run) == 0
    assert carry_out(ROOM, run) == 0


@meta
def test_a_room_is_filmed_with_another_simulator(
    controller: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where the one that the run was trained with is missing."""
    monkeypatch.setattr(UNDRAWN, lambda *frames: None)
    run = shutil.copytree(controller, tmp_path / "run")
    info = json.loads((run / "run.json").read_text())
    info["config"]["simulator"] = {"name": "elsewhere"}
    (run / "run.json").write_text(json.dumps(info))
    assert carry_out(ROOM, run, "simulator=mujoco") == 0


def test_a_controller_keeps_the_skills_that_it_was_trained_over(
    skill: Path, tmp_path: Path
) -> None:
    """Of each its policy, so that the run can go to another machine without them."""
    walk, run, turn = tmp_path / "walk", tmp_path / "run", tmp_path / "turn.json"
    shutil.copytree(skill, walk)
    packed = installed().registry.find("skill", "sitting/turn_left").factory()
    for suffix in (".json", ".safetensors"):
        shutil.copy(packed.with_suffix(suffix), turn.with_suffix(suffix))
    four = f"actuation.runs=['{walk}','{turn}',sitting/turn_right,sitting/sit]"
    words = ("experiment=sitting/meta", *TINY, four, "num_worlds=4", "budget.samples=32")
    assert main(["train", *words, f"run.dir={run}"]) == 0
    shutil.rmtree(walk)
    turn.unlink()
    moved = run.rename(tmp_path / "moved")
    assert carry_out(TRIALS, moved) == 0
    (copy,) = {path.parent for path in (moved / "inputs").rglob("run.json")}
    state, _ = checkpoint.load(copy / "checkpoints" / "00000001")
    assert state.keys() == {"policy", "progress"}
    assert sum(f.stat().st_size for f in copy.rglob("*") if f.is_file()) < 200_000
    with (copy / "run.json").open("a") as file:
        file.write(" ")
    assert carry_out(TRIALS, moved) != 0


def test_a_skill_that_there_is_not(capsys: pytest.CaptureFixture[str], tmp_path: Path) -> None:
    words = ("experiment=sitting/meta", *TINY, "actuation.runs=[sitting/wlk]", "num_worlds=4")
    assert main(["train", *words, f"run.dir={tmp_path / 'run'}"]) == 2
    assert "sitting/walk" in capsys.readouterr().err


def test_a_success_of_each_zone_and_the_commonest_failure_are_shown(
    controller: Path, tmp_path: Path
) -> None:
    """Of these nobody sits, so there are failures alone."""
    run = tmp_path / "run"
    shutil.copytree(controller, run)
    assert main(["sitting", "trials", str(run), "--trials", "2", "--film"]) == 0
    (film,) = json.loads((run / FILE).read_text())["films"]
    assert re.match(r"\d+ of 64 failures: it does not sit for long enough, walk at", film["title"])
    assert (run / film["file"]).stat().st_size > 1000
    page = TransitionsSection().html(runs.open_run(run))
    assert page is not None
    assert page.count("<video") == 1
    assert " of 64 failures: it does not" in page
    found = json.loads((run / FILE).read_text())
    outside = [{"title": "<b>", "file": "../run.json"}]
    (run / FILE).write_text(json.dumps({**found, "films": outside}))
    assert "<video" not in (TransitionsSection().html(runs.open_run(run)) or "")
