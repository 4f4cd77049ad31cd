"""Each guard is held by a test: without it, that test fails (``make mutants``)."""

from __future__ import annotations

import re
import shlex
import subprocess
from pathlib import Path

import pytest
from all_at_once import ROOT, command, copy_of_the_tree, environment, verdict
from mutants import MUTANTS, Mutant

BY_NAME = pytest.mark.parametrize(
    "mutant", MUTANTS, ids=[m.name.replace(" ", "-") for m in MUTANTS]
)


@BY_NAME
def test_the_guard_is_where_it_was(mutant: Mutant) -> None:
    assert (ROOT / mutant.file).read_text(encoding="utf-8").count(mutant.before) == 1
    for word in shlex.split(mutant.tests.partition(" -")[0]):
        assert (ROOT / word).exists()


def test_every_fault_has_a_guard_to_lose() -> None:
    """Each on docs/reliability.md has a test that fails without a guard of it."""
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    rows = dict(re.findall(r"^\| (\d+) \|.*\|([^|]*)\|$", page, re.MULTILINE))
    assert list(rows) == [str(n) for n in range(1, 33)]
    tried = {word for m in MUTANTS for word in shlex.split(m.tests.partition(" -")[0])}
    for number, cell in rows.items():
        named = re.findall(r"`((?:tests/)?[\w/]+(?:\.py)?)`", cell)
        files = [
            name if "/" in name else f"tests/faults/{name}" for name in named if "test" in name
        ]
        assert [(ROOT / file).exists() for file in files] == [True] * max(len(files), 1), number
        assert any(f.startswith(t) or t.startswith(f) for f in files for t in tried), number


def test_every_promise_has_a_guard_to_lose() -> None:
    """Each claim on docs/reliability.md names it, and a test that it is tried by."""
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    section = page.partition("## What holds each promise")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (.+) \| (`.+`) \| (`.+`) \|$", section, re.MULTILINE)
    assert len(rows) == section.count("\n| ") - 1 > 20, "all but the head"
    guards = {m.name: m.tests.partition(" -")[0] for m in MUTANTS}
    for claim, tests, names in rows:
        files = [f if "/" in f else f"tests/faults/{f}" for f in re.findall(r"`([^`]+)`", tests)]
        tried = [shlex.split(guards[name]) for name in re.findall(r"`([^`]+)`", names)]
        assert all(any(f.startswith(t) for f in files for t in words) for words in tried), claim
        assert all(any(f.startswith(t) for words in tried for t in words) for f in files), claim


def test_every_attack_has_a_guard_to_lose() -> None:
    """Each of the 13 kinds on docs/reliability.md, and each of its rows names what holds it."""
    page = (ROOT / "docs" / "reliability.md").read_text(encoding="utf-8")
    section = page.partition("## Attacks, before and after")[2].partition("\n## ")[0]
    rows = re.findall(r"^\| (\d+)\. .+ \| .+ \| .+ \| (`[^|]+`) \|$", section, re.MULTILINE)
    assert len(rows) == section.count("\n| ") - 1, "all but the head"
    assert sorted({int(number) for number, _ in rows}) == list(range(1, 14))
    named = {name for _, names in rows for name in re.findall(r"`([^`]+)`", names)}
    assert named <= {m.name for m in MUTANTS}


def test_a_missing_package_notices_nothing() -> None:
    """Only a test that passes with all guards can; where there is none, the mutant could not run."""
    passes = {"status": 0, "passed": ["a"], "failed": [], "skipped": [], "missing": []}
    fails = {**passes, "status": 1, "passed": [], "failed": ["a"], "missing": ["viser"]}
    assert verdict(passes, fails) == ("noticed", "a")
    assert verdict(passes, {**passes, "status": -9}) == ("noticed", "status -9")
    assert verdict(passes, passes) == ("missed", "")
    assert verdict(passes, {**passes, "status": 2})[0] == "unclear"
    assert verdict(fails, None) == (
        "could not run", "1 of its tests fail anyway, not installed: viser"
    )  # fmt: skip


@pytest.fixture(scope="module")
def tree(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the tree, to be mutated."""
    return copy_of_the_tree(tmp_path_factory.mktemp("trees") / "tree")


def run(tree: Path, tests: str) -> subprocess.CompletedProcess[str]:
    """The tests in the copy, whose modules come before the installed ones."""
    done = subprocess.run(
        [*command(tests), "-x"], cwd=tree, capture_output=True, text=True, env=environment(tree)
    )
    if done.returncode == pytest.ExitCode.NO_TESTS_COLLECTED:
        pytest.skip(f"{tests} need what is not installed here")
    return done


@pytest.mark.slow
@pytest.mark.parametrize("tests", sorted({m.tests for m in MUTANTS}))
def test_with_all_guards_they_pass(tests: str, tree: Path) -> None:
    """Else they would notice whatever is done."""
    done = run(tree, tests)
    assert done.returncode == 0, f"{done.stdout[-3000:]}{done.stderr[-1000:]}"


@pytest.mark.slow
@BY_NAME
def test_without_the_guard_a_test_fails(mutant: Mutant, tree: Path) -> None:
    file = tree / mutant.file
    text = file.read_text(encoding="utf-8")
    file.write_text(text.replace(mutant.before, mutant.after), encoding="utf-8")
    try:
        done = run(tree, mutant.tests)
    finally:
        file.write_text(text, encoding="utf-8")
    if mutant.survives and done.returncode == 0:
        pytest.xfail(mutant.survives)
    assert done.returncode == 1 or done.returncode < 0, (  # a signal may have ended the tests
        f"status {done.returncode}\n{done.stdout[-3000:]}{done.stderr[-1000:]}"
    )
