"""The kernel's modules: no circle of imports, and rooms that build on those below them alone."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from graphlib import CycleError, TopologicalSorter
from pathlib import Path

import pytest

import understudy

ROOT = Path(understudy.__file__).parent

#: Rooms from the bottom up: each may import, when it is loaded, the ones before it and itself.
#: ``setup.building`` makes environments and ``records`` describe experiments, so modules of
#: ``running``, ``setup`` and ``records`` interleave; that there is no circle among them is tested.
FLOORS = (
    {"errors", "options", "distributed", "random", "folders", "inputs", "signals"},
    {"task"},
    {"running", "setup", "records"},
    {"command"},
    {"testing", "__main__"},
)


def module_of(file: Path) -> str:
    parts = ("understudy", *file.relative_to(ROOT).with_suffix("").parts)
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


def statements(body: list[ast.stmt]) -> Iterator[ast.stmt]:
    """What runs when the module is loaded, but for blocks under TYPE_CHECKING."""
    for statement in body:
        if isinstance(statement, ast.If) and "TYPE_CHECKING" in ast.unparse(statement.test):
            yield from statements(statement.orelse)
        elif isinstance(statement, (ast.FunctionDef, ast.AsyncFunctionDef)):
            continue
        else:
            yield statement
            for name in ("body", "orelse", "finalbody"):
                yield from statements(getattr(statement, name, []))


def imports(tree: ast.Module, modules: set[str]) -> set[str]:
    """The modules among `modules` that loading `tree` imports by name."""
    found = set()
    for statement in statements(tree.body):
        if isinstance(statement, ast.Import):
            found |= {alias.name for alias in statement.names}
        elif isinstance(statement, ast.ImportFrom):
            base = statement.module or ""
            names = {f"{base}.{alias.name}" for alias in statement.names}
            found |= (names & modules) or {base}
            if not names <= modules:
                found.add(base)
    return found & modules


def graph() -> dict[str, set[str]]:
    files = {module_of(file): file for file in ROOT.rglob("*.py")}
    return {
        name: imports(ast.parse(file.read_text(encoding="utf-8")), set(files)) - {name}
        for name, file in files.items()
    }


def test_no_circle_of_imports() -> None:
    try:
        order = list(TopologicalSorter(graph()).static_order())
    except CycleError as error:
        pytest.fail(" → ".join(error.args[1]))
    assert order.index("understudy.errors") < order.index("understudy.running.environment")


def floor(module: str) -> int:
    room = module.split(".")[1]
    return next(i for i, rooms in enumerate(FLOORS) if room in rooms)


def test_rooms_build_on_those_below() -> None:
    found = graph()
    rooms = {m for m in found if m != "understudy"}
    upwards = [
        f"{module} imports {other}"
        for module in sorted(rooms)
        for other in sorted(found[module] - {"understudy"})
        if floor(other) > floor(module)
    ]
    assert not upwards


def test_the_graph_is_the_real_one() -> None:
    """The test can fail: some edges that are there, and none that only types need."""
    found = graph()
    assert "understudy.running.table" in found["understudy.running.environment"]
    assert "understudy.task.terms" in found["understudy.running.table"]
    assert "understudy.running.environment" not in found["understudy.task.physics"]
    assert "understudy.distributed" in found["understudy.random"]


def test_the_kernel_stays_small() -> None:
    """Testing aside, it has no more lines than the page of measurements allows, and no file has more than a tenth."""
    page = Path(__file__).resolve().parents[2] / "docs" / "benchmarks" / "README.md"
    (most,) = re.findall(r"^The kernel may have (\S+) lines", page.read_text("utf-8"), re.M)
    allowed = int(most.replace(",", ""))
    lines = {
        str(file.relative_to(ROOT)): file.read_text(encoding="utf-8").count("\n")
        for file in ROOT.rglob("*.py")
        if file.parent.name != "testing"
    }
    assert sum(lines.values()) <= allowed
    assert {name: n for name, n in lines.items() if n > allowed / 10} == {}
