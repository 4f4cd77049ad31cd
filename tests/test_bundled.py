"""The bundled plugins are what stands in the tree: no list of them is kept. Each registers its parts alike."""

from __future__ import annotations

import ast
import sys
import tomllib
from importlib import metadata
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import known_entries
import pytest

pytest.importorskip("hatchling", reason="building the distribution needs hatchling (dev extra)")

ROOT = Path(__file__).resolve().parents[1]
sys.path.append(str(ROOT))

from hatch_build import EntryPoints, Packages, bundled  # noqa: E402

from understudy.setup.plugins import installed  # noqa: E402


def test_what_is_installed_is_what_stands_in_the_tree() -> None:
    entries = metadata.entry_points(group="understudy")
    installed = {e.name: e.value for e in entries if e.dist and e.dist.name == "understudy"}
    assert installed == {name: f"understudy_{name}" for name in bundled(ROOT)}
    assert len(installed) > 30


def test_what_tests_find_is_what_python_finds(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Entry points are kept for a path of this tree and its environment alone."""
    assert metadata.entry_points is known_entries.found
    ours = metadata.entry_points(group="understudy")
    assert set(ours) == set(known_entries.real(group="understudy"))
    info = tmp_path / "stranger-1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Name: stranger\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text("[understudy]\nodd = odd_plugin\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert {e.name for e in metadata.entry_points(group="understudy")} == {*ours.names, "odd"}


def test_no_file_names_the_plugins_again() -> None:
    text = (ROOT / "pyproject.toml").read_text(encoding="utf-8")
    assert [name for name in bundled(ROOT) if f"understudy_{name}" in text] == []
    assert "entry-points" in tomllib.loads(text)["project"]["dynamic"]


def test_no_room_is_of_odds_and_ends() -> None:
    said_nothing = {"basics", "common", "helpers", "misc", "shared", "util", "utils"}
    places = [*ROOT.glob("kernel/**/*.py"), *ROOT.glob("plugins/**/*.py")]
    words = {word for place in places for part in place.relative_to(ROOT).with_suffix("").parts for word in part.split("_")}  # fmt: skip
    assert {"learning", "registry"} <= words
    assert words & said_nothing == set()


def tables(module: str) -> dict[str, ast.Dict]:
    """The tables of parts in the text of a `module`, by kind."""
    for node in ast.parse(module).body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "PARTS":
            assert isinstance(node.value, ast.Dict)
            kinds = zip(node.value.keys, node.value.values, strict=True)
            return {ast.literal_eval(kind): table for kind, table in kinds if kind and isinstance(table, ast.Dict)}  # fmt: skip
    return {}


def broken_rows(module: str) -> list[str]:
    """Parts that are no row ``"NAME": ("PLACE", "what it is"),`` of one line of at most 100 characters."""
    lines = module.splitlines()
    return [
        ast.unparse(row)
        for table in tables(module).values()
        for name, row in zip(table.keys, table.values, strict=True)
        if name is None
        or not isinstance(row, ast.Tuple)
        or name.lineno != row.end_lineno
        or len(lines[name.lineno - 1]) > 100
    ]


def test_each_part_is_a_row_of_its_plugins_table() -> None:
    modules = {path: path.read_text("utf-8") for path in ROOT.glob("plugins/*/*/*/__init__.py")}
    found = installed().registry.components.values()
    rows = sum(len(table.keys) for text in modules.values() for table in tables(text).values())
    packaged = sum(component.kind == "skill" for component in found)  # found in a folder
    assert rows + packaged == sum(c.distribution == "understudy" for c in found)
    assert {
        str(path): broken_rows(text) for path, text in modules.items() if broken_rows(text)
    } == {}


@pytest.mark.parametrize(
    "row",
    ['"a/b":\n            ("c:D", "e"),', f'"a/b": ("c:D", "{80 * "e"}"),', '"a/b": made(),'],
    ids=["two lines", "too long", "no row"],
)
def test_another_way_to_register_is_seen(row: str) -> None:
    module = 'PARTS = {\n    "reward": {\n        ROW\n    },\n}\n'
    assert broken_rows(module.replace("ROW", '"a/b": ("c:D", "e"),')) == []
    assert len(broken_rows(module.replace("ROW", row))) == 1


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
