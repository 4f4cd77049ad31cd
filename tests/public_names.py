"""The public surface: what `__all__` of the kernel's and the plugins' modules names.

``python tests/public_names.py`` writes it to ``docs/public-names.txt``, which is kept with the code: a change
of a name, or of what a function takes, is then seen as a line of the diff. Modules are read, not imported.
"""

from __future__ import annotations

import ast
import difflib
import functools
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
LISTED = ROOT / "docs" / "public-names.txt"
HEAD = """\
# What plugins may import from the kernel and from one another, by module: the names in its `__all__`, with
# what functions take and what classes have. Written by `python tests/public_names.py`; do not edit.
"""


def packages(root: Path = ROOT) -> dict[str, Path]:
    """The folder of the kernel's package and of each plugin's, by name."""
    found = [root / "kernel" / "understudy"]
    found += sorted((root / "plugins").glob("*/*/understudy_*"))
    return {folder.name: folder for folder in found if (folder / "__init__.py").is_file()}


@functools.cache
def modules(root: Path = ROOT) -> dict[str, ast.Module]:
    """The kernel's and the plugins' modules, parsed, by dotted name."""
    found = {}
    for package, folder in packages(root).items():
        for file in sorted(folder.rglob("*.py")):
            parts = [package, *file.relative_to(folder).with_suffix("").parts]
            name = ".".join(part for part in parts if part != "__init__")
            found[name] = ast.parse(file.read_text(encoding="utf-8"), str(file))
    return found


def public(module: ast.Module) -> list[str]:
    """What its `__all__` names; nothing without one."""
    for node in module.body:
        if isinstance(node, ast.Assign) and ast.unparse(node.targets[0]) == "__all__":
            return list(ast.literal_eval(node.value))
    return []


def taken(function: ast.FunctionDef | ast.AsyncFunctionDef) -> str:
    """Its parameters with their defaults, without types."""
    arguments = ast.parse(ast.unparse(function.args).join(["def f(", "): pass"])).body[0]
    assert isinstance(arguments, ast.FunctionDef)
    given = arguments.args
    for argument in [*given.posonlyargs, *given.args, *given.kwonlyargs, given.vararg, given.kwarg]:
        if argument is not None:
            argument.annotation = None
    return f"({ast.unparse(given)})"


def of_class(node: ast.ClassDef) -> Iterator[str]:
    """Its public attributes and methods, a line each."""
    for item in node.body:
        if isinstance(item, ast.FunctionDef | ast.AsyncFunctionDef):
            decorators = {ast.unparse(one) for one in item.decorator_list}
            if any(one.endswith((".setter", "overload")) for one in decorators):
                continue
            if item.name == "__init__":
                yield f"    {item.name}{taken(item)}"
            elif not item.name.startswith("_"):
                is_value = decorators & {"property", "cached_property", "functools.cached_property"}
                yield f"    {item.name}{'' if is_value else taken(item)}"
        elif isinstance(item, ast.AnnAssign):
            name = ast.unparse(item.target)
            if not name.startswith("_"):
                given = f" = {ast.unparse(item.value)}" if item.value is not None else ""
                yield f"    {name}{given}"


def lines(module: ast.Module) -> Iterator[str]:
    """What a module makes public, a line for each name and each member."""
    defined: dict[str, ast.AST] = {}
    for node in ast.walk(module) if public(module) else ():
        if isinstance(node, ast.ClassDef | ast.FunctionDef | ast.AsyncFunctionDef):
            defined.setdefault(node.name, node)
    for name in sorted(public(module)):
        node = defined.get(name)
        if isinstance(node, ast.ClassDef):
            bases = ", ".join(map(ast.unparse, node.bases))
            yield f"  class {name}({bases})" if bases else f"  class {name}"
            yield from of_class(node)
        elif isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef):
            yield f"  {name}{taken(node)}"
        else:
            yield f"  {name}"


def surface(root: Path = ROOT) -> str:
    """The whole list, as it is kept."""
    text = HEAD
    for name, module in modules(root).items():
        if shown := list(lines(module)):
            text += "\n".join(["", name, *shown]) + "\n"
    return text


def changes(root: Path = ROOT, listed: Path = LISTED) -> str:
    """What the code has and the list has not, and the other way round; empty where they agree."""
    before = listed.read_text(encoding="utf-8").splitlines() if listed.is_file() else []
    found = difflib.unified_diff(
        before, surface(root).splitlines(), "listed", "in the code", lineterm="", n=1
    )
    return "\n".join(found)


def dotted(node: ast.expr) -> str:
    """``a.b.c``; empty for what is not names alone."""
    if isinstance(node, ast.Name):
        return node.id
    if isinstance(node, ast.Attribute) and (base := dotted(node.value)):
        return f"{base}.{node.attr}"
    return ""


def borrowed(module: ast.Module, known: set[str]) -> set[tuple[str, str]]:
    """Pairs (module, name): what it takes of `known` modules, by import or as an attribute of one."""
    found: set[tuple[str, str]] = set()
    bound: dict[str, str] = {}
    for node in ast.walk(module):
        if isinstance(node, ast.ImportFrom) and node.module in known:
            for alias in node.names:
                whole = f"{node.module}.{alias.name}"
                if whole in known:
                    bound[alias.asname or alias.name] = whole
                else:
                    found.add((str(node.module), alias.name))
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name in known and alias.asname:
                    bound[alias.asname] = alias.name
    for node in ast.walk(module):
        if isinstance(node, ast.Attribute):
            base = dotted(node.value)
            if base in bound:
                found.add((bound[base], node.attr))
            elif base in known:
                found.add((base, node.attr))
    return {(base, name) for base, name in found if f"{base}.{name}" not in known}


def main() -> None:
    """Write the list and print what changed."""
    told = changes()
    LISTED.write_text(surface(), encoding="utf-8")
    sys.stdout.write(f"{told or 'Nothing changed.'}\n")


if __name__ == "__main__":
    main()
