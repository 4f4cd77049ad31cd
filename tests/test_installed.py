"""Parts take what they are handed: only what begins a program asks for the plugins of this process."""

from __future__ import annotations

import ast
import sys
from pathlib import Path

import pytest
import recorded_runs
import torch

from understudy.records import runs
from understudy.setup import plugins as setup_plugins
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, load
from understudy.task import Context
from understudy.testing import fake
from understudy_characters.recording import recorded_scene
from understudy_characters.scene import CharacterScene

ROOT = Path(__file__).resolve().parents[1]

#: Beside commands: where nothing else was given, and a list for Gymnasium's own registry.
DEFAULTS = {
    "setup/composition.py", "testing/conformance.py", "records/runs.py",
    "understudy_characters/scene.py", "understudy_skills/skill.py", "understudy_skills/folder.py", "understudy_gym/envs.py",
    "understudy_inspect/replay.py", "understudy_sweeps/sweep.py",
    "understudy_reproduce/comparison.py", "understudy_inspect/origins.py",
    "understudy_training/workflow.py", "understudy_training/watching.py", "command/cli.py", "understudy_credits/walk.py",
}  # fmt: skip


def asks(file: Path) -> bool:
    """Whether it calls ``installed()``."""
    text = file.read_text(encoding="utf-8")
    tree = ast.parse(text if "installed" in text else "")
    calls = (node.func for node in ast.walk(tree) if isinstance(node, ast.Call))
    return any(ast.unparse(f).rpartition(".")[2] == "installed" for f in calls)


def test_only_commands_ask_for_the_plugins_of_the_process() -> None:
    asking = {
        file for folder in ("kernel", "plugins") for file in (ROOT / folder).rglob("*.py") if asks(file)
    }  # fmt: skip
    others = {
        "/".join(file.parts[-2:])
        for file in asking
        if "(Command):" not in file.read_text(encoding="utf-8")  # a class of one
    }
    assert others == DEFAULTS


@pytest.fixture
def handed_over(monkeypatch: pytest.MonkeyPatch) -> Plugins:
    """Plugins that are not installed, where asking for the installed ones is an error."""
    found = load(extra=[("fake", fake), ("croucher", recorded_runs)])

    def installed() -> None:
        raise AssertionError("the plugins of this process")

    for module in [m for name, m in sys.modules.items() if name.startswith("understudy")]:
        if getattr(module, "installed", None) is setup_plugins.installed:
            monkeypatch.setattr(module, "installed", installed)
    return found


def test_a_character_of_a_plugin_that_is_handed_over_is_built(
    handed_over: Plugins, tmp_path: Path
) -> None:
    overrides = [
        "+scene={name: character, character: croucher}", *fake.FAKE_TASK[1:], f"run.dir={tmp_path / 'run'}",
    ]  # fmt: skip
    experiment = load_experiment(overrides, handed_over)
    context = Context(
        0, torch.device("cpu"), 1, control_dt=1 / 30, substeps=20, registry=handed_over.registry
    )
    scene = experiment.need("scene").build(context)
    assert isinstance(scene, CharacterScene)
    assert scene.character.name == "croucher"
    run = runs.create(experiment, overrides, {})
    run.unlock()
    shown = recorded_scene(run)
    assert isinstance(shown, CharacterScene)
    assert shown.character.joint_names == scene.character.joint_names
