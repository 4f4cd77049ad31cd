"""Plugins are data: name, place and sentence of each part stand in one line of a table, and a hook does only what
is none."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from understudy.setup.plugins import Plugins, installed

ROOT = Path(__file__).resolve().parents[2]
MODULES = sorted(
    [
        *ROOT.glob("plugins/*/*/understudy_*/__init__.py"),
        *ROOT.glob("tests/external/*/src/understudy_*/__init__.py"),
    ]
)
#: The longest line of a table.
WIDTH = 100
#: Kinds whose parts are files beside the code, found by listing their folder.
LISTED = {"skill"}
#: What may make a hook: what these register has to be found out.
FOUND_OUT = {"skills_beside"}


def faults(text: str) -> Iterator[str]:
    """What in a plugin's module `text` is registered otherwise than by its table."""
    lines, tree = text.splitlines(), ast.parse(text)
    for node in ast.walk(tree):
        if isinstance(node, ast.Attribute) and node.attr == "component":
            yield f"line {node.lineno}: register.component; write a row of PARTS"
        if isinstance(node, ast.FunctionDef) and node.name.startswith("understudy_"):
            yield f"line {node.lineno}: {node.name} does what a table can; write a table"
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]).startswith("understudy_"):
            made_by = ast.unparse(getattr(node.value, "func", node.value))
            if made_by not in FOUND_OUT:
                yield f"line {node.lineno}: {made_by} does what a table can; write a table"
    for kinds in tables(tree):
        for rows in kinds.values:
            if not isinstance(rows, ast.Dict):
                yield f"line {rows.lineno}: no mapping of names"
                continue
            for name, row in zip(rows.keys, rows.values, strict=True):
                number = (name or row).lineno
                cells = [c.value for c in getattr(row, "elts", ()) if isinstance(c, ast.Constant)]
                if number != row.end_lineno or len(lines[number - 1]) > WIDTH:
                    yield f"line {number}: not one line of {WIDTH} characters"
                if not isinstance(name, ast.Constant) or len(cells) != 2:
                    yield f"line {number}: not a name, a place and a sentence, as they are"
                elif not re.fullmatch(r"[\w.]+:\w+", str(cells[0])) or len(str(cells[1])) < 5:
                    yield f"line {number}: no module:name, or no sentence"


def tables(tree: ast.Module) -> list[ast.Dict]:
    return [
        node.value
        for node in tree.body
        if isinstance(node, ast.Assign)
        and isinstance(node.value, ast.Dict)
        and [getattr(target, "id", "") for target in node.targets] == ["PARTS"]
    ]


@pytest.mark.parametrize("module", MODULES, ids=lambda path: path.parent.name)
def test_parts_stand_in_one_table(module: Path) -> None:
    assert list(faults(module.read_text(encoding="utf-8"))) == []


@pytest.fixture(scope="module")
def plugins() -> Plugins:
    return installed()


@pytest.mark.parametrize(
    "module", [m for m in MODULES if "external" not in m.parts], ids=lambda path: path.parent.name
)
def test_the_table_has_all_that_is_registered(module: Path, plugins: Plugins) -> None:
    name = module.parent.name.removeprefix("understudy_")
    known = plugins.registry.components.items()
    found = {key for key, part in known if part.plugin == name and part.kind not in LISTED}
    found_rows = [ast.literal_eval(table) for table in tables(ast.parse(module.read_text("utf-8")))]
    rows = {(kind, part) for table in found_rows for kind, parts in table.items() for part in parts}
    assert rows == found


@pytest.mark.parametrize(
    ("row", "fault"),
    [
        ('"a/b": ("terms:b", "what b is, in a sentence"),', None),
        ('"a/b": (\n            "terms:b", "what b is, in a sentence"\n        ),', "not one line"),
        (f'"a/b": ("terms:b", "{"long " * 20}"),', "not one line"),
        ('"a/b": ("terms:b", ""),', "no sentence"),
        ('"a/b": ("terms.b", "what b is, in a sentence"),', "no module:name"),
        ('"a/b": (f"{HERE}:b", "what b is, in a sentence"),', "not a name, a place"),
        ('NAME: ("terms:b", "what b is, in a sentence"),', "not a name, a place"),
        ('"a/b": "terms:b",', "not a name, a place"),
    ],
)
def test_others_are_refused(row: str, fault: str | None) -> None:
    text = f'PARTS = {{\n    "reward": {{\n        {row}\n    }},\n}}\n'
    found = list(faults(text))
    assert (found == []) if fault is None else any(fault in line for line in found)


def test_hooks_that_a_table_replaces_are_refused() -> None:
    single = 'def understudy_register(register):\n    register.task("a/b", "c")\n'
    assert [line for line in faults(single) if "write a table" in line]
    assert [line for line in faults("understudy_register = my_hook\n") if "write a table" in line]
    assert list(faults("understudy_register = skills_beside(__file__)\n")) == []


def test_single_calls_are_refused() -> None:
    for call in ('register.component("reward", "a/b", "m:b", "c")', "add = register.component"):
        text = f"def understudy_register(register):\n    {call}\n"
        assert [line for line in faults(text) if "write a row" in line]
