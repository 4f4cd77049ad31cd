"""The bundled plugins are what stands in the tree: no list of them is kept."""

from __future__ import annotations

import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

pytest.importorskip("hatchling", reason="building the distribution needs hatchling (dev extra)")

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from hatch_build import EntryPoints, Packages, bundled  # noqa: E402


def test_what_is_installed_is_what_stands_in_the_tree() -> None:
    entries = metadata.entry_points(group="understudy")
    installed = {e.name: e.value for e in entries if e.dist and e.dist.name == "understudy"}
    assert installed == {name: f"understudy_{name}" for name in bundled(ROOT)}
    assert len(installed) > 30


def test_no_file_names_the_plugins_again() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert [name for name in bundled(ROOT) if f"understudy_{name}" in text] == []
    assert "entry-points" in tomllib.loads(text)["project"]["dynamic"]


@pytest.fixture
def tree(tmp_path: Path) -> Path:
    for file in ("skills/juggling/understudy_juggling", "skills/juggling/docs", "skills/odd/understudy_even"):  # fmt: skip
        folder = tmp_path / "plugins" / file
        folder.mkdir(parents=True)
        (folder / "__init__.py").touch()
    return tmp_path


def test_a_new_folder_is_a_plugin(tree: Path) -> None:
    given: dict[str, Any] = {}
    EntryPoints(str(tree), {}).update(given)
    assert given == {"entry-points": {"understudy": {"juggling": "understudy_juggling"}}}


@pytest.mark.parametrize("version", ["standard", "editable"])
def test_its_package_is_in_the_wheel_or_on_the_path(tree: Path, version: str) -> None:
    config: Any = SimpleNamespace(dev_mode_dirs=[])
    hook = Packages(str(tree), {}, config, None, str(tree), "wheel")  # type: ignore[arg-type]
    data: dict[str, Any] = {"force_include": {}}
    hook.initialize(version, data)
    folder = "plugins/skills/juggling"
    if version == "editable":
        assert config.dev_mode_dirs == ["kernel", folder]
        assert data["force_include"] == {}
    else:
        package = "understudy_juggling"
        assert data["force_include"] == {"conf": "understudy/conf", f"{folder}/{package}": package}
