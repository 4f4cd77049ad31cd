"""Fault 23: a plugin that cannot be loaded is named with its reason, and the others work."""

from __future__ import annotations

import sys
from importlib import metadata
from pathlib import Path
from types import ModuleType, SimpleNamespace
from typing import Any

import pytest
from worlds import SMALL

from understudy.command.cli import main
from understudy.errors import ConfigError, PluginError
from understudy.setup import plugins as plugins_module
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.testing import fake
from understudy.testing.fake import FAKE_TASK


def module(**hooks: Any) -> ModuleType:
    made = ModuleType("stranger")
    for name, function in hooks.items():
        setattr(made, name, hookimpl(function))
    return made


def status(plugins: Plugins, name: str = "stranger") -> str:
    return {p.name: p.status for p in plugins.loaded}[name]


def assert_isolated(plugins: Plugins, reason: str) -> None:
    """Listed once with its reason; nothing of it is left; the others train."""
    assert [p.name for p in plugins.loaded].count("stranger") == 1
    assert reason in status(plugins)
    assert "\n" not in status(plugins)
    assert not [c for c in plugins.registry.components.values() if c.plugin == "stranger"]
    assert not [t for t in plugins.registry.tasks.values() if t.plugin == "stranger"]
    assert not [s for s in plugins.registry.sections.values() if s.plugin == "stranger"]
    assert not [c for c in plugins.registry.citations if c[0] == "stranger"]
    assert "stranger_kind" not in plugins.registry.kinds
    assert "stranger_slot" not in plugins.registry.slots
    assert "stranger" not in [name for name, _ in plugins.config_directories()]
    assert all(p.status == "ok" for p in plugins.loaded if p.name in ("ppo", "mujoco", "fake"))
    build_environment(load_experiment([*FAKE_TASK, *SMALL], plugins)).environment.reset()
    raw = [*FAKE_TASK, *SMALL, "learner.name=stranger/learner"]
    with pytest.raises(ConfigError) as caught:
        load_experiment(raw, plugins)
    assert f"Plugin 'stranger' did not load: {status(plugins)}" in str(caught.value)


def loaded(stranger: Any) -> Plugins:
    return load(extra=[("fake", fake), ("stranger", stranger)])


def duplicate(register: Registrar) -> None:
    register.component("learner", "stranger/learner", object)
    register.component("learner", "ppo", object)


def duplicate_section(register: Registrar) -> None:
    register.section("stranger", dict, dict)
    register.task("stranger/task", "a task")
    register.component("learner", "stranger/learner", object)
    register.component("learner", "stranger/learner", object)


def unknown_kind(register: Registrar) -> None:
    register.component("learner", "stranger/learner", object)
    register.component("lerner", "stranger/other", object)


def kinds(register: Registrar) -> None:
    register.kind("stranger_kind", "of its own")
    register.slot("stranger_slot", "stranger_kind", "of its own")
    register.citation("stranger", "Stranger 2001.")
    register.component("stranger_kind", "x", object)
    register.slot("job", "job", "the kernel's")


def dotted(register: Registrar) -> None:
    register.slot("reward.more", "reward", "below another's")


def raises(register: Registrar) -> None:
    register.component("learner", "stranger/learner", object)
    raise RuntimeError("no\nlicence")


def leaves(register: Registrar) -> None:
    sys.exit("stranger wants to leave")


@pytest.mark.parametrize(
    ("register", "reason"),
    [
        (duplicate, "Both plugin 'ppo' and plugin 'stranger' register the learner 'ppo'"),
        (duplicate_section, "register the learner 'stranger/learner'"),
        (unknown_kind, "no kind of component. Did you mean 'learner'?"),
        (kinds, "adds the slot 'job', which exists already"),
        (dotted, "adds the slot 'reward.more', which exists already or has a dot"),
        (raises, "RuntimeError: no"),
        (leaves, "SystemExit: stranger wants to leave"),
    ],
)
def test_registering(register: Any, reason: str) -> None:
    assert_isolated(loaded(module(understudy_register=register)), reason)


def test_misspelled_hook() -> None:
    def register(register: Registrar) -> None:
        register.component("learner", "stranger/learner", object)

    assert_isolated(
        loaded(module(understudy_register=register, understudy_registre=register)),
        "understudy_registre",
    )
    plain = ModuleType("stranger")
    plain.understudy_regster = register  # type: ignore[attr-defined]  # not even marked as a hook
    assert_isolated(
        loaded(plain),
        "defines 'understudy_regster', which is no hook. The hooks are: understudy_register,",
    )


def test_wrong_hook_signature() -> None:
    assert_isolated(loaded(module(understudy_register=lambda register, more: None)), "stranger")


def test_config_directories(tmp_path: Path) -> None:
    (tmp_path / "conf/learner").mkdir(parents=True)
    (tmp_path / "conf/learner/ppo.yaml").write_text("name: stranger/learner\n")
    shadows = module(understudy_config_directory=lambda: tmp_path / "conf")
    assert_isolated(
        loaded(shadows), "the config option 'learner/ppo', which plugin 'ppo' provides already"
    )
    (tmp_path / "mine/experiment").mkdir(parents=True)
    (tmp_path / "mine/config.yaml").write_text("seed: 7\n")
    takes = module(understudy_config_directory=lambda: tmp_path / "mine")
    assert_isolated(
        loaded(takes), "the config option 'config', which understudy itself provides already"
    )
    missing = module(understudy_config_directory=lambda: tmp_path / "nowhere")
    assert_isolated(loaded(missing), "nowhere does not exist")


class Entry(SimpleNamespace):
    """An entry point of a distribution ``strange`` 1.0."""

    def load(self) -> ModuleType:
        if isinstance(self.what, BaseException):
            raise self.what
        return self.what


def with_entry(monkeypatch: pytest.MonkeyPatch, *entries: Entry) -> None:
    real = list(metadata.entry_points(group="understudy"))
    monkeypatch.setattr(metadata, "entry_points", lambda group: [*real, *entries])


def entry(what: Any, value: str = "stranger", dist: str = "strange") -> Entry:
    return Entry(
        name="stranger", value=value, what=what, dist=SimpleNamespace(name=dist, version="1.0")
    )


@pytest.mark.parametrize(
    "error",
    [
        ImportError("libgone.so is missing"),
        ZeroDivisionError("x"),
        SystemExit("bye"),
        SyntaxError("y"),
    ],
)
def test_import(monkeypatch: pytest.MonkeyPatch, error: BaseException) -> None:
    with_entry(monkeypatch, entry(error))
    plugins = load(extra=[("fake", fake)])
    assert_isolated(plugins, f"{type(error).__name__}: {error}")
    found = next(p for p in plugins.loaded if p.name == "stranger")
    assert (found.distribution, found.version) == ("strange", "1.0")


def test_bundled_plugins_come_first(monkeypatch: pytest.MonkeyPatch) -> None:
    """A stranger whose name sorts before cannot take a bundled plugin's place."""
    stranger = entry(module(understudy_register=duplicate))
    stranger.name = "aaa"
    with_entry(monkeypatch, stranger)
    plugins = load()
    assert status(plugins, "ppo") == "ok"
    assert "Both plugin 'ppo' and plugin 'aaa'" in status(plugins, "aaa")


def test_component_whose_module_is_missing() -> None:
    """Registered lazily: only asking for it fails, and says whose it is."""

    def register(register: Registrar) -> None:
        register.component("learner", "stranger/learner", "no_such_module:Learner")
        register.component("learner", "stranger/other", "understudy_ppo.learner:Missing")

    plugins = loaded(module(understudy_register=register))
    assert status(plugins) == "ok"
    for name, reason in (
        ("learner", "No module named 'no_such_module'"),
        ("other", "which does not exist"),
    ):
        with pytest.raises(
            Exception, match=rf"learner 'stranger/{name}' of plugin 'stranger' .*{reason}"
        ):
            load_experiment([*FAKE_TASK, *SMALL, f"learner.name=stranger/{name}"], plugins)


def test_commands(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    with_entry(monkeypatch, entry(ImportError("libgone.so is missing")))
    plugins_module.installed.cache_clear()
    try:
        assert main(["plugins"]) == 0
        assert (
            "stranger 1.0 (strange): ImportError: libgone.so is missing" in capsys.readouterr().out
        )
        assert main(["config", "learner=stranger/learner"]) == 2
        assert (
            "Plugin 'stranger' did not load: ImportError: libgone.so is missing"
            in capsys.readouterr().err
        )
    finally:
        plugins_module.installed.cache_clear()


def test_disabled(monkeypatch: pytest.MonkeyPatch) -> None:
    with_entry(monkeypatch, entry(ImportError("x")))
    monkeypatch.setenv("UNDERSTUDY_DISABLE_PLUGINS", "stranger, mujoco")
    assert not {"stranger", "mujoco"} & {p.name for p in load().loaded}
    monkeypatch.setenv("UNDERSTUDY_PLUGINS", "ppo,stranger")
    assert [p.name for p in load().loaded] == ["ppo"]


def test_a_name_that_is_no_plugin_is_refused(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("UNDERSTUDY_PLUGINS", "ppo,nope")
    with pytest.raises(
        PluginError, match="UNDERSTUDY_PLUGINS names 'nope', which is no installed plugin"
    ):
        load()
    monkeypatch.setenv("UNDERSTUDY_PLUGINS", "moton")
    with pytest.raises(PluginError, match="Did you mean 'motion'"):
        load()
