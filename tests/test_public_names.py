"""What plugins take from the kernel and from one another is what is made public, and the list says what."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest
from public_names import LISTED, ROOT, borrowed, changes, modules, public, surface

MODULES = modules(ROOT)


def test_the_list_is_what_the_code_makes_public() -> None:
    told = changes()
    assert not told, f"Run `python tests/public_names.py` if this is meant:\n{told}"


def test_a_change_is_a_line_of_the_diff(tmp_path: Path) -> None:
    listed = tmp_path / "names.txt"
    text = LISTED.read_text(encoding="utf-8")
    listed.write_text(text.replace("  derive_seed(", "  derive_seeds(", 1), encoding="utf-8")
    told = changes(listed=listed).splitlines()
    assert [
        line.split("(")[0] for line in told if line[0] in "-+" and line[:3] not in ("---", "+++")
    ] == [
        "-  derive_seeds",
        "+  derive_seed",
    ]


def test_members_of_a_public_class_and_defaults_are_listed(tmp_path: Path) -> None:
    package = tmp_path / "kernel" / "understudy"
    package.mkdir(parents=True)
    (package / "__init__.py").write_text(
        '__all__ = ["Box", "put"]\n\n\nclass Box:\n    size: int = 3\n    _kept: int\n\n'
        "    @property\n    def full(self) -> bool: ...\n\n    def _turn(self): ...\n\n\n"
        "def put(box: Box, *, tight: bool = False) -> None: ...\n\n\ndef other(): ...\n"
    )
    shown = surface(tmp_path).split("understudy\n")[-1].splitlines()
    assert shown == ["  class Box", "    size = 3", "    full", "  put(box, *, tight=False)"]


@pytest.mark.parametrize("name", sorted({name.partition(".")[0] for name in MODULES}))
def test_takes_only_public_names_of_others(name: str) -> None:
    """Of the kernel and of other plugins: whatever stands in an `__all__`."""
    taken = {
        f"{module} has no {word} in its __all__, which {user} uses"
        for user, tree in MODULES.items()
        if user.partition(".")[0] == name
        for module, word in borrowed(tree, set(MODULES))
        if module.partition(".")[0] != name and word not in public(MODULES[module])
    }
    assert taken == set()


def test_a_public_name_stands_in_its_module() -> None:
    for name, module in MODULES.items():
        bound: set[str] = set()
        for node in ast.walk(module) if public(module) else ():
            if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
                bound.add(node.name)
            elif isinstance(node, ast.ImportFrom | ast.Import):
                bound |= {alias.asname or alias.name for alias in node.names}
            elif isinstance(node, ast.Name) and isinstance(node.ctx, ast.Store):
                bound.add(node.id)
        assert set(public(module)) - bound == set(), name
