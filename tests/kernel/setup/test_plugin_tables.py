"""A plugin may be data alone: tables in its module, and options beside it."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path
from types import ModuleType

import pytest

from understudy.records.observer import RunObserver
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import TABLES, Registrar
from understudy.testing import fake

TEXT = """
REQUIRES = ()
KINDS = {"paint": "what colours a scene"}
SLOTS = {
    "paint": {"kind": "paint", "summary": "the colour of all"},
    "layers": {"kind": "paint", "summary": "one above the other", "many": True},
}
PARTS = {
    "paint": {"data/red": ("colours:Red", "red")},
    "observer": {"data/watcher": ("colours:Watcher", "watches")},
}
SECTIONS = {"canvas": ("colours:Options", "colours:build")}
TASKS = {"data/draw": "draw"}
CITATIONS = {"data": "Newton 1704. Opticks."}
"""

PARTS = """
from understudy.records.observer import RunObserver


class Red:
    pass


class Watcher(RunObserver):
    pass


class Options:
    pass


def build():
    pass
"""


@pytest.fixture
def package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> ModuleType:
    """A package that is installed, with no function in its module."""
    folder = tmp_path / "house_of_data"
    (folder / "conf/paint").mkdir(parents=True)
    (folder / "__init__.py").write_text(TEXT)
    (folder / "colours.py").write_text(PARTS)
    (folder / "conf/paint/red.yaml").write_text("name: data/red\n")
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    return importlib.import_module("house_of_data")


def loaded(module: object) -> Plugins:
    found = load(only=(), extra=[("fake", fake), ("data", module)])
    assert found.registry.broken == {}
    return found


def test_all_tables_are_registered(package: ModuleType) -> None:
    plugins = loaded(package)
    registry = plugins.registry
    assert {title for title in TABLES if hasattr(package, title)} == TABLES.keys()
    assert registry.kinds["paint"].summary == "what colours a scene"
    assert [registry.slots[name].many for name in ("paint", "layers")] == [False, True]
    assert registry.find("paint", "data/red").target == "house_of_data.colours:Red"
    section = registry.sections["canvas"]
    assert (section.options.target, section.build.target) == (
        "house_of_data.colours:Options",
        "house_of_data.colours:build",
    )
    assert registry.tasks["data/draw"].plugin == "data"
    assert registry.citations["data", "data"].summary == "Newton 1704. Opticks."
    assert dict(plugins.folders())["data"] == Path(str(package.__file__)).parent / "conf"


def test_nothing_is_imported_before_it_is_used(package: ModuleType) -> None:
    plugins = loaded(package)
    assert "house_of_data.colours" not in sys.modules
    watcher = plugins.registry.find("observer", "data/watcher").factory()
    assert isinstance(watcher, RunObserver)
    assert type(watcher).__module__ == "house_of_data.colours"


def test_a_hook_may_stand_beside_tables(package: ModuleType) -> None:
    def register(register: Registrar) -> None:
        register.component("paint", "data/found", object, "found in a folder")

    package.understudy_register = hookimpl(register)  # type: ignore[attr-defined]
    assert loaded(package).registry.names("paint") == ["data/found", "data/red"]


@pytest.mark.parametrize(
    "own",
    [("walk", "run"), {"walk": 3}, {"walk": "walk"}, 5, {"reward": {"walk": "no row"}}],
    ids=repr,
)
@pytest.mark.parametrize("title", sorted(TABLES))
def test_a_module_with_hooks_may_call_its_own_as_tables_are_called(title: str, own: object) -> None:
    """Unless it says, by ``REQUIRES``, that it is a plugin's with tables."""
    module = ModuleType("own")
    setattr(module, title, own)
    module.understudy_register = hookimpl(  # type: ignore[attr-defined]
        lambda register: register.component("reward", "own/found", object, "found")
    )
    registry = loaded(module).registry
    assert registry.names("reward").count("own/found") == 1
    assert [*registry.tasks, *registry.citations] == []


def test_a_broken_table_of_a_plugin_with_hooks_is_named() -> None:
    module = ModuleType("broken")
    module.REQUIRES, module.TASKS = (), ("walk", "run")  # type: ignore[attr-defined]
    module.understudy_register = hookimpl(lambda register: None)  # type: ignore[attr-defined]
    broken = load(only=(), extra=[("data", module)]).registry.broken
    assert "its table TASKS is not as tables are. Write TASKS = {" in broken["data"]


def test_a_module_in_no_package_has_no_options_by_convention(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "conf").mkdir()  # another's, which lies beside
    (tmp_path / "house_alone.py").write_text(
        'PARTS = {"reward": {"alone": ("house_alone:a", "a")}}'
    )
    monkeypatch.syspath_prepend(tmp_path)
    monkeypatch.setattr(sys, "modules", dict(sys.modules))
    plugins = loaded(importlib.import_module("house_alone"))
    assert "data" not in dict(plugins.folders())
    assert plugins.registry.find("reward", "alone").target == "house_alone:a"
