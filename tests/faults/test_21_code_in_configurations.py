"""Fault 21: Python paths in overrides, run folders and checkpoints are refused before any import."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from worlds import SMALL, make_training, resumed

from understudy.command.cli import main
from understudy.errors import ConfigError, UnderstudyError
from understudy.records import checkpoint, runs
from understudy.records.runs import Run
from understudy.setup.composition import compose_raw, load_experiment
from understudy.setup.plugins import Plugins, kernel_conf
from understudy.setup.validation import CODE_KEYS, refuse_code, validate
from understudy.testing.fake import FAKE_TASK
from understudy_inspect.origins import origins
from understudy_inspect.replay import replay_step
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Trial


@pytest.fixture(autouse=True)
def _sentinel(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A module ``sentinel`` that leaves a file behind when anybody imports it."""
    package = tmp_path / "path/sentinel"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(f"open({str(tmp_path / 'imported')!r}, 'w')\n")
    monkeypatch.syspath_prepend(str(tmp_path / "path"))
    monkeypatch.delitem(sys.modules, "sentinel", raising=False)


@pytest.fixture
def untouched(tmp_path: Path) -> Path:
    return tmp_path / "imported"


@pytest.mark.parametrize(
    "override",
    [
        *(f"+scene.{key}=sentinel.x" for key in sorted(CODE_KEYS)),
        "+learner={name: ppo, _target_: sentinel.x}",
        "+anything.deep={list: [{_target_: sentinel.x}]}",
        "+reward.terms.a={_target_: sentinel.x, name: fake/near_origin}",
        "hydra.searchpath=[pkg://sentinel]",
        "++hydra.searchpath=[pkg://sentinel]",
        "+hydra.callbacks.a._target_=sentinel.x",
        "hydra/launcher=sentinel",
    ],
)
def test_overrides(plugins: Plugins, untouched: Path, override: str) -> None:
    for use in (load_experiment, origins):
        if use is origins and "hydra" not in override:
            continue
        with pytest.raises(ConfigError):
            use([*FAKE_TASK, *SMALL, override], plugins)
    assert not untouched.exists()


@pytest.mark.parametrize(
    ("slot", "name"),
    [
        ("scene", "sentinel:x"),
        ("learner", "sentinel.x"),
        ("policy", "sentinel"),
        ("simulator", "/tmp/x.py"),
    ],
)
def test_python_paths_as_names(plugins: Plugins, untouched: Path, slot: str, name: str) -> None:
    raw = load_experiment([*FAKE_TASK, *SMALL], plugins).effective()
    with pytest.raises(ConfigError, match=rf"There is no {slot} '{name}'"):
        validate({**raw, slot: {"name": name}}, plugins.registry)
    assert not untouched.exists()


def test_run_folder_and_checkpoint(plugins: Plugins, tmp_path: Path, untouched: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.save()
    assert training.run is not None
    training.run.unlock()
    file = tmp_path / "run/run.json"
    good = json.loads(file.read_text())
    evil = {**good["config"], "scene": {"name": "fake", "_target_": "sentinel.x"}}
    file.write_text(json.dumps({**good, "config": evil}))
    with pytest.raises(
        ConfigError, match=r"scene\._target_: configurations name registered components"
    ):
        runs.open_run(tmp_path / "run")
    file.write_text(
        json.dumps({**good, "overrides": [*good["overrides"], "hydra.searchpath=[pkg://sentinel]"]})
    )
    with pytest.raises(ConfigError, match="Hydra itself cannot be configured"):
        resumed(plugins, tmp_path / "run", more=["seed=0"])
    file.write_text(json.dumps(good))
    state, meta = checkpoint.load(tmp_path / "run/checkpoints/00000000")
    checkpoint.save(tmp_path / "run/checkpoints/00000000", state, {**meta, "config": evil})
    resumed(plugins, tmp_path / "run")  # a checkpoint's configuration is only compared
    checkpoint.save(tmp_path / "step", {"worlds": [0]}, {"config": evil})
    with pytest.raises(UnderstudyError, match="_target_"):
        replay_step(tmp_path / "step", plugins)
    assert not untouched.exists()


@pytest.mark.parametrize("key", sorted(CODE_KEYS))
def test_wherever_it_stands(key: str) -> None:
    for value in ([{key: "x"}], {"a": [[{"b": ({key: "x"},)}]]}, {"a": {"b": {key: "x"}}}):
        with pytest.raises(ConfigError, match=f"{key}: configurations name registered components"):
            refuse_code(value)


SECRET = "words of nobody else's"


@pytest.fixture
def secret(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A file of options beside the folder where commands are given, and a value of the environment."""
    file = tmp_path / "elsewhere.yaml"
    file.write_text(f"# @package _global_\nrun:\n  dir: {SECRET}\n")
    monkeypatch.setenv("SECRET", SECRET)
    return file


@pytest.mark.parametrize(
    "form",
    ["experiment={up}", "+experiment={up}", "++experiment={up}", "experiment=[{up}]", "task={up}",
     "policy={up}", "search={absolute}", "experiment={absolute}", "experiment@run={up}", "experiment='{up}'",
     "+experiment@_global_={up}", "experiment=x/../{up}", "{up}=x", "experiment/deep={up}",
     "experiment='${{oc.env:SECRET}}'", "experiment=${{oc.env:SECRET}}"],
)  # fmt: skip
def test_options_elsewhere(plugins: Plugins, secret: Path, form: str) -> None:
    up = os.path.relpath(secret.with_suffix(""), kernel_conf() / "experiment")
    override = form.format(up=up, absolute=secret.with_suffix(""))
    for use in (compose_raw, origins):
        with pytest.raises(ConfigError, match=r"names no option|cannot be read") as caught:
            use([override], plugins)
        assert SECRET not in str(caught.value)


def test_files_of_parts_may_be_anywhere(plugins: Plugins) -> None:
    raw = compose_raw(["+scene.character=../robot.xml", "run.dir=/tmp/x", "device=cpu"], plugins)
    assert raw["scene"]["character"] == "../robot.xml"


RESOLVED = ["{key}=${{oc.env:SECRET}}", "{key}='${{oc.env:SECRET}}'", "{key}=${{oc.decode:'1'}}",
            "{key}=${{${{task}}:SECRET}}", "+run={{dir: '${{oc.env:SECRET}}'}}"]  # fmt: skip


@pytest.mark.parametrize("form", RESOLVED)
def test_resolvers_of_strangers(
    tmp_path: Path, secret: Path, form: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a run; what its reader sets anew is the reader's own."""
    run = tmp_path / "run"
    small = ["budget.samples=200", "run.video_seconds=0", "evaluation.criterion=null"]
    assert main(["train", "experiment=miniature/go", f"run.dir={run}", *small]) == 0
    info = json.loads((run / "run.json").read_text())
    info["overrides"].append(form.format(key="task"))
    (run / "run.json").write_text(json.dumps(info))
    capsys.readouterr()
    for command in ("resume", "evaluate", "render"):
        assert main([command, str(run), "control.frequency=20"]) == 2
        error = capsys.readouterr().err
        assert "would be read from this machine" in error
        assert SECRET not in error
    if form.startswith("{key}"):
        words = runs.open_run(run).words(["task=miniature/go"])
        assert words[-1] == "task=miniature/go"


def test_interpolations_within_are_taken(tmp_path: Path) -> None:
    plain = ["a=${seed}", "b={x: ${seed}, y: 1}", "c=${run.dir}"]
    assert Run(tmp_path, {"overrides": plain}).words(["d=${oc.env:HOME}"])[:3] == plain


def test_resolvers_in_a_journal(tmp_path: Path) -> None:
    journal = Journal(tmp_path / "journal.jsonl")
    journal.ask(Trial("one", overrides=("seed=1",)))
    with pytest.raises(ConfigError, match="would be read from this machine"):
        journal.ask(Trial("two", overrides=("run.dir=${oc.env:SECRET}",)))
    row = json.loads(journal.path.read_text())
    row["trial"] |= {"key": "two", "overrides": ["run.dir=${oc.env:SECRET}"]}
    with journal.path.open("a") as file:
        file.write(json.dumps(row) + "\n")
    assert [trial.key for trial in Journal.read(journal.path).asked] == ["one"]
