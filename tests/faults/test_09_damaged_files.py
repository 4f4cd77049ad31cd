"""Fault 9: truncated, empty and changed files are refused; resuming falls back and says so."""

from __future__ import annotations

import argparse
import copy
import hashlib
import json
import shutil
from pathlib import Path

import pytest
import torch
from worlds import SMALL, assert_same_state, make_training, resumed

from understudy.errors import RunError
from understudy.records import checkpoint, runs
from understudy.records.runs import open_run
from understudy.setup import plugins as setup_plugins
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_judging import commands
from understudy_skills.skill import open_skill


@pytest.fixture
def path(tmp_path: Path) -> Path:
    generator = torch.Generator().manual_seed(0)
    state = {"w": torch.randn(40, 5, generator=generator), "n": 3, "list": [1.5, None, "text"]}
    checkpoint.save(tmp_path / "00000001", state, {"config": {"seed": 1}})
    return tmp_path / "00000001"


@pytest.mark.parametrize("ending", [".json", ".safetensors"])
def test_every_byte_matters(path: Path, ending: str) -> None:
    file = path.with_suffix(ending)
    whole = file.read_bytes()
    good = checkpoint.load(path)
    harmless = 0
    for position in range(len(whole)):
        for bit in (0x01, 0x20, 0x80):
            broken = bytearray(whole)
            broken[position] ^= bit
            file.write_bytes(broken)
            try:
                found = checkpoint.load(path)
            except RunError as error:
                assert str(path) in str(error)  # noqa: PT017
            else:  # another spelling of the same JSON, and nothing else
                assert_same_state(found[0], good[0])
                assert found[1] == good[1]
                harmless += 1
    assert harmless <= 4


@pytest.mark.parametrize("ending", [".json", ".safetensors"])
def test_truncated_and_empty(path: Path, ending: str) -> None:
    file = path.with_suffix(ending)
    whole = file.read_bytes()
    for length in range(0, len(whole), 7):
        file.write_bytes(whole[:length])
        with pytest.raises(RunError, match=r"damaged"):
            checkpoint.load(path)
    file.write_bytes(whole + b"\0")
    with pytest.raises(RunError, match=r"damaged"):
        checkpoint.load(path)
    file.unlink()
    with pytest.raises(RunError, match=r"cannot be read: No such file"):
        checkpoint.load(path)


@pytest.mark.parametrize("ending", [".json", ".safetensors"])
def test_resume_falls_back(plugins: Plugins, tmp_path: Path, ending: str) -> None:
    run = tmp_path / "run"
    training = make_training(plugins, [*FAKE_TASK, *SMALL], run)
    states = []
    for _ in range(2):
        row = training.iterate()
        assert training.run is not None
        training.run.append_metrics(row)
        training.save()
        states.append(copy.deepcopy(training.state_dict()))
    training.run.unlock()
    file = (run / "checkpoints/00000002").with_suffix(ending)
    data = bytearray(file.read_bytes())
    data[len(data) // 2] ^= 0x10
    file.write_bytes(data)
    messages: list[str] = []
    again = resumed(plugins, run, messages)
    assert again.progress.iteration == 1
    assert_same_state(again.state_dict(), states[0], ignore=())
    assert any("00000002" in m and "damaged" in m and "Falling back" in m for m in messages)
    assert again.run is not None
    assert [row["iteration"] for row in again.run.metrics()] == [1]


def test_all_damaged(plugins: Plugins, tmp_path: Path) -> None:
    run = tmp_path / "run"
    training = make_training(plugins, [*FAKE_TASK, *SMALL], run)
    training.iterate()
    training.save()
    assert training.run is not None
    training.run.unlock()
    (run / "checkpoints/00000001.json").write_bytes(b"")
    with pytest.raises(
        RunError, match=r"no usable checkpoint\. The newest: .*00000001\.json is damaged"
    ):
        resumed(plugins, run)


@pytest.mark.parametrize("folder_too", [True, False])
def test_checkpoints_that_are_gone_do_not_begin_a_training_anew(
    plugins: Plugins, tmp_path: Path, folder_too: bool
) -> None:
    """As of a run that was copied without them; what it left stays."""
    run = tmp_path / "run"
    training = make_training(plugins, [*FAKE_TASK, *SMALL], run)
    assert training.run is not None
    training.run.append_metrics(training.iterate())
    training.run.unlock()
    shutil.rmtree(run / "checkpoints")
    if not folder_too:
        (run / "checkpoints").mkdir()
    before = {path: path.read_bytes() for path in run.iterdir() if path.is_file()}
    with pytest.raises(
        RunError, match=r"checkpoints has no checkpoint, .* metrics\.jsonl tells of cannot go on"
    ):
        resumed(plugins, run)
    assert {path: path.read_bytes() for path in run.iterdir() if path.is_file()} == before


@pytest.mark.parametrize("content", ["[]", "null", "3", '{"config": {}}', '{"layout": 1}'])
def test_a_record_of_something_else(tmp_path: Path, content: str) -> None:
    (tmp_path / "run.json").write_text(content)
    with pytest.raises(
        RunError, match=r"run\.json is damaged: it does not say what was trained\.$"
    ):
        open_run(tmp_path)


@pytest.mark.parametrize("number", ["Infinity", "-Infinity", "NaN", "1e999"])
@pytest.mark.parametrize("key", ["config", "sources"])
def test_a_record_with_numbers_that_no_checkpoint_holds(
    tmp_path: Path, key: str, number: str
) -> None:
    """A training went on from it, and ended in a traceback when it was to be saved."""
    info = {"layout": 3, "config": {}, "overrides": [], "sources": {}, key: {"task": "ODD"}}
    (tmp_path / "run.json").write_text(json.dumps(info).replace('"ODD"', number))
    with pytest.raises(RunError, match=r"run\.json is damaged: Out of range float values"):
        open_run(tmp_path)


@pytest.mark.parametrize("number", ["Infinity", "NaN", "1e999"])
def test_a_checkpoint_with_numbers_that_none_is_written_with(tmp_path: Path, number: str) -> None:
    """Of a packed skill its versions went on into a run, whose saving ended in a traceback."""
    checkpoint.save(tmp_path / "skill", {"x": torch.ones(2)}, {"versions": "ODD"})
    outer = json.loads((tmp_path / "skill.json").read_text())
    body = outer["content"].replace('"ODD"', number)
    digest = hashlib.sha256(body.encode()).hexdigest()
    (tmp_path / "skill.json").write_text(json.dumps({"digest": digest, "content": body}))
    with pytest.raises(RunError, match=r"skill\.json is damaged: it is no complete checkpoint\."):
        checkpoint.load(tmp_path / "skill")


def test_an_untrained_policy_is_not_judged_as_the_trained_one(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(setup_plugins, "installed", lambda: plugins)
    run = tmp_path / "run"
    few = ("evaluation.final_episodes=4", "evaluation.seconds=1")
    training = make_training(plugins, [*FAKE_TASK, *SMALL, *few], run)
    training.save()
    assert training.run is not None
    training.run.unlock()
    chosen = argparse.Namespace(run=str(run), overrides=[])
    assert commands.Evaluate().run(chosen) == 0  # nothing was trained, and that is what is judged
    training.run.append_metrics(training.iterate())
    training.save()
    (run / "checkpoints/00000001.json").write_bytes(b"")
    for command in (commands.Evaluate(), commands.Render()):
        with pytest.raises(RunError, match="only the checkpoint before training is intact"):
            command.run(chosen)
    for using in (
        lambda: open_skill(str(run), registry=plugins.registry),
        lambda: runs.newest_state(str(run)),
    ):
        with pytest.raises(RunError, match=r"run: only the checkpoint before training is intact"):
            using()


def test_a_run_without_a_checkpoint_of_its_training_is_said(
    plugins: Plugins,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """As of one that is trained just now, of which nothing is damaged."""
    monkeypatch.setattr(setup_plugins, "installed", lambda: plugins)
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.save()
    assert training.run is not None
    training.run.unlock()
    assert open_skill(str(tmp_path / "run"), registry=plugins.registry).samples == 0
    assert not capsys.readouterr().err, "it was not trained yet"
    training.run.append_metrics(training.iterate())
    assert open_skill(str(tmp_path / "run"), registry=plugins.registry).samples == 0
    assert "nothing is learned in it" in capsys.readouterr().err
    chosen = argparse.Namespace(run=str(tmp_path / "run"), overrides=[])
    with pytest.raises(RunError, match="no checkpoint yet but that before training"):
        commands.Evaluate().run(chosen)


def test_an_older_checkpoint_is_not_played_in_silence(
    plugins: Plugins,
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.setattr(setup_plugins, "installed", lambda: plugins)
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    assert training.run is not None
    for _ in range(2):
        training.run.append_metrics(training.iterate())
        training.save()
    training.run.unlock()
    trained = open_skill(str(tmp_path / "run"), registry=plugins.registry).samples
    assert not capsys.readouterr().err
    (tmp_path / "run/checkpoints/00000002.safetensors").write_bytes(b"")
    assert 0 < open_skill(str(tmp_path / "run"), registry=plugins.registry).samples < trained
    assert "Falling back to the one before it" in capsys.readouterr().err
