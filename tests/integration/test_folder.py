"""A skill where a command takes a run: its folder below runs/skills."""

from __future__ import annotations

import dataclasses
import json
from pathlib import Path
from typing import Any

import miniatures
import pytest

from understudy.command.cli import main
from understudy.errors import ConfigError, RunError
from understudy.records import runs
from understudy_skills import as_run, folder, pack
from understudy_skills.folder import run_folder
from understudy_skills.pack_inputs import PackInputs
from understudy_skills.skill import open_skill


@pytest.fixture(scope="module")
def packed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """``go.json`` and its tensors, a policy of one iteration."""
    place = tmp_path_factory.mktemp("packed")
    run = f"run.dir={place / 'run'}"
    miniatures.train(
        "experiment=miniature/go",
        "budget.samples=1024",
        *miniatures.QUICK,
        run,
        "run.video_seconds=0",
    )
    assert main(["play", str(place / "run"), "--pack", str(place / "go.json")]) == 0
    return place / "go.json"


def test_commands_take_a_skill_where_they_take_a_run(
    packed: Path,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["evaluate", str(packed), "episodes=4", "half_step=false"]) == 0
    assert "is unpacked as the run runs/skills/" in capsys.readouterr().err
    (made,) = Path("runs/skills").iterdir()
    own = json.loads((made / "evaluation.json").read_text())
    assert own == open_skill(str(packed)).card["evaluation"]
    assert json.loads((made / "evaluation-episodes-4.json").read_text())["episodes"] == 4
    assert runs.open_run(made).config["run"]["dir"] == str(made)
    assert f"run.dir={made}" in runs.open_run(made).info["overrides"]


def test_a_training_begins_with_no_pack(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:  # fmt: skip
    """It was called a folder that has no run.json."""
    monkeypatch.chdir(tmp_path)
    words = ["experiment=miniature/go", f"start.run={packed}", "run.dir=new"]
    assert main(["train", *words]) == 2
    assert f"`understudy play {packed} --unpack runs/go` makes one" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_it_is_unpacked_once(packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    first = run_folder(str(packed))
    monkeypatch.setattr(folder, "unpack", None)
    assert run_folder(str(packed)) == first


def test_another_skill_of_the_same_name_has_its_own_folder(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    first = run_folder(str(packed))
    card = json.loads(packed.read_text())
    packed.write_text(json.dumps(card, indent=2))
    monkeypatch.setattr(folder, "unpack", lambda skill, path: _make(path))
    assert run_folder(str(packed)) != first


def _make(path: Path) -> None:
    path.mkdir()
    (path / "run.json").write_text("{}")


def test_nothing_is_left_of_one_that_cannot_be_unpacked(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(path: Path, *_: object) -> None:
        raise RunError(f"{path}: the disk is full.")

    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(as_run.checkpoint, "save", fails)
    with pytest.raises(RunError, match="disk is full"):
        run_folder(str(packed))
    assert list(Path("runs/skills").iterdir()) == []
    with pytest.raises(RunError, match=r"^own/run/checkpoints/00000001: the disk is full"):
        as_run.unpack(open_skill(str(packed)), Path("own/run"))
    assert list(Path("own").iterdir()) == []


def test_a_folder_with_something_in_it_is_not_unpacked_into(
    packed: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    opened = open_skill(str(packed))
    for name in ("empty", "mine"):
        Path(name).mkdir()
    Path("mine/notes.txt").write_text("of another day")
    as_run.unpack(opened, Path("empty"))
    assert Path("empty/run.json").is_file()
    with pytest.raises(RunError, match=r"empty already holds a run\. Give another folder"):
        as_run.unpack(opened, Path("empty"))
    with pytest.raises(RunError, match=r"mine cannot be made: Directory not empty\. Give another"):
        as_run.unpack(opened, Path("mine"))
    assert sorted(p.name for p in Path().iterdir() if not p.name.startswith("runs")) == [
        "empty", "mine",
    ]  # fmt: skip
    assert [p.name for p in Path("mine").iterdir()] == ["notes.txt"]


@pytest.mark.parametrize("name", ["nosuch", "walk", "clip.json"])
def test_what_is_no_skill_stays_as_it_is(name: str, tmp_path: Path) -> None:
    clip = tmp_path / "clip.json"  # clips, too, may end so
    clip.write_text("{}")
    source = str(clip) if name == clip.name else name
    assert run_folder(source) == source


def test_a_run_stays_as_it_is(packed: Path) -> None:
    assert run_folder(str(packed.parent / "run")) == str(packed.parent / "run")


def test_what_is_read_of_another_run_by_no_name_is_not_packed(
    built_on: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """But for what its parts asked for; what a training began with, or a job took, is not read again."""
    opened = pack.gathering(open_skill(str(built_on / "sleeve")))
    monkeypatch.chdir(built_on / "go")
    run, config = str(built_on / "go"), dict(opened.card["config"])

    def refuse(part: str, options: dict[str, Any]) -> None:
        own = {**opened.card, "config": {**config, part: options}}
        pack.refuse_of_others(dataclasses.replace(opened, card=own))

    for key in ("start", "job"):
        refuse(key, {"run": run})
    with pytest.raises(ConfigError, match=r"reward\.terms\.style\.runs\.0=.* Override it"):
        refuse("reward", {"terms": {"style": {"runs": [run]}}})
    stages = {"stages": [{"run": run}]}
    with pytest.raises(ConfigError, match=r"actuation\.stages\.0\.run=.* Pass on the run folder"):
        refuse("actuation", stages)
    for word in ("", "x" * 5000, "a\0b"):  # the empty one named the working folder
        refuse("reward", {"terms": {"style": {"runs": [word]}}})
    inputs = opened.experiment.inputs
    assert isinstance(inputs, PackInputs)
    inputs.asked.add(f"features {run}")
    refuse("actuation", stages)


def test_nothing_names_no_run() -> None:
    """An empty variable named the working folder."""
    with pytest.raises(RunError, match="'' names no run, as of an empty variable"):
        run_folder("")
