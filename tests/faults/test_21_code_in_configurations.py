"""Fault 21: Python paths in overrides, run folders and checkpoints are refused before any import."""

from __future__ import annotations

import json
import sys
from pathlib import Path

import pytest
from worlds import SMALL, make_training, resumed

from understudy.errors import ConfigError, UnderstudyError
from understudy.records import checkpoint, runs
from understudy.setup.composition import load_experiment
from understudy.setup.config import CODE_KEYS, refuse_code, validate
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_inspect.origins import origins
from understudy_inspect.replay import replay_step


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
