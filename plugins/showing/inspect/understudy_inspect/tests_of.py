"""Where the tests of a part are, if its sources lie beside tests."""

from __future__ import annotations

import ast
import inspect
import re
import sysconfig
import warnings
from collections import Counter
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

from understudy.setup.registry import Component


def tests_of(component: Component) -> list[Path]:
    """The test files of the part's plugin that name the part, those first that name it most.

    It is named by its class or function, imported or taken from a module, or as a configuration chooses it. None are
    found of a package that is installed without its tests.
    """
    factory = inspect.unwrap(component.factory)
    folder = _folder(factory, component.plugin)
    if folder is None:
        return []
    own = getattr(factory, "__name__", "")
    chosen = re.compile(
        rf"(?:^|name: ?|[='\"]|{component.kind}/){re.escape(component.name)}(?![\w/-])"
    )
    found: dict[Path, int] = {}
    for file in sorted({*folder.rglob("test_*.py"), *folder.rglob("*_test.py")}):
        try:
            text = file.read_text(encoding="utf-8", errors="replace")
        except OSError:  # a link to nothing, say
            continue
        if own in text or component.name in text:
            found[file] = _count(text, own, chosen)
    return sorted((f for f, count in found.items() if count), key=lambda f: (-found[f], f))


def _folder(factory: object, plugin: str) -> Path | None:
    """Where the plugin's tests are: ``tests/plugins/NAME`` of a tree of several plugins, else ``tests``, beside the
    nearest ``pyproject.toml`` above the package; None if there are none."""
    try:
        file = Path(inspect.getfile(factory)).resolve()  # type: ignore[arg-type]
    except (OSError, TypeError):  # there is no source
        return None
    paths = sysconfig.get_paths()
    if any(file.is_relative_to(Path(paths[name]).resolve()) for name in ("purelib", "platlib")):
        return None  # a tree around an environment says nothing of what is installed in it
    root = next((f for f in file.parents if (f / "pyproject.toml").is_file()), None)
    if root is None:
        return None
    several = root / "tests" / "plugins"
    folder = several / plugin if several.is_dir() else root / "tests"
    return folder if folder.is_dir() else None


@dataclass(frozen=True)
class _Named:
    """What a test file names, each as often as it does."""

    imported: tuple[tuple[str, str], ...]  #: what is imported, and under which name
    constants: tuple[str, ...]  #: texts
    names: Counter[str]
    attributes: Counter[str]


@lru_cache(64)  # the tests of a plugin are asked for each of its parts
def _named(text: str) -> _Named | None:
    """What a test file's `text` names; None if it is no Python."""
    try:
        with warnings.catch_warnings(action="ignore"):  # of what a test file escapes
            nodes = list(ast.walk(ast.parse(text)))
    except (SyntaxError, ValueError):  # the latter of bytes that are none of Python's
        return None
    constants = (n.value for n in nodes if isinstance(n, ast.Constant))
    return _Named(
        tuple(
            (alias.name, alias.asname or alias.name)
            for node in nodes
            if isinstance(node, ast.ImportFrom)
            for alias in node.names
        ),
        tuple(value for value in constants if isinstance(value, str)),
        Counter(node.id for node in nodes if isinstance(node, ast.Name)),
        Counter(node.attr for node in nodes if isinstance(node, ast.Attribute)),
    )


def _count(text: str, own: str, chosen: re.Pattern[str]) -> int:
    """How often a test file's `text` names the part: by its `own` name, or as a configuration has `chosen` it."""
    named = _named(text)
    if named is None:
        return 0
    imported = {under for name, under in named.imported if name == own}
    by_choice = sum(len(chosen.findall(constant)) for constant in named.constants)
    return by_choice + sum(named.names[name] for name in imported) + named.attributes[own]
