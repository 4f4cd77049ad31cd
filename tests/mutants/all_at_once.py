"""Lose every guard, several at once: ``python tests/mutants/all_at_once.py --jobs 14 --out FILE``.

A mutant is tried by those of its tests that pass here with all guards in place, so a package that is missing
on this machine notices nothing: a mutant of which no test passes *could not run*. Each result is one line of
the file as it comes, and the same command goes on where another was stopped.
"""

from __future__ import annotations

import argparse
import contextlib
import importlib.metadata
import itertools
import json
import os
import queue
import re
import shlex
import shutil
import signal
import subprocess
import sys
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Callable
from concurrent.futures import FIRST_COMPLETED, Future, ThreadPoolExecutor, wait
from pathlib import Path
from typing import Any

import pytest

ROOT = Path(__file__).resolve().parents[2]
#: What the tests need.
COPIED = (
    "kernel",
    "plugins",
    "tests",
    "conf",
    "benchmarks",
    "docs",
    "pyproject.toml",
    "hatch_build.py",
    "README.md",
    "Makefile",
)
#: Where the tests of a tree say what came of each of them.
_OUTCOMES = "UNDERSTUDY_OUTCOMES"
Record = dict[str, Any]


def pytest_runtest_logreport(report: pytest.TestReport) -> None:
    """As a plugin of pytest in a tree's tests: one line for what came of each part of each of them."""
    if _OUTCOMES in os.environ:
        with Path(os.environ[_OUTCOMES]).open("a", encoding="utf-8") as out:
            out.write(json.dumps([report.nodeid, report.when, report.outcome]) + "\n")


def copy_of_the_tree(copy: Path) -> Path:
    """What the tests need, in the folder `copy`."""
    for name in COPIED:
        source = ROOT / name
        if source.is_dir():
            shutil.copytree(source, copy / name, ignore=shutil.ignore_patterns("__pycache__"))
        else:
            copy.mkdir(parents=True, exist_ok=True)
            shutil.copy(source, copy / name)
    return copy


def command(tests: str) -> list[str]:
    """That which runs the tests, in words as a mutant has them."""
    files, _, options = tests.partition(" -")
    chosen = ["-" + options[0], options[1:].strip()] if options else []
    if options.startswith("m slow -k "):
        chosen = ["-m", "slow", "-k", options.removeprefix("m slow -k ")]
    return [
        *(sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", "--timeout=300"),
        *(*shlex.split(files), *chosen),
    ]


def environment(tree: Path) -> dict[str, str]:
    """In which the tree's modules come before the installed ones, and before what is on the path already."""
    path = [tree / "kernel", *sorted((tree / "plugins").glob("*/*")), tree / "tests"]
    already = os.environ.get("PYTHONPATH", "")
    return {
        **os.environ,
        "PYTHONPATH": os.pathsep.join(
            filter(None, [*map(str, path), str(tree / "tests" / "mutants"), already])
        ),
        "PYTHONDONTWRITEBYTECODE": "1",
    }


def _name_the_plugins(tree: Path) -> None:
    """Where understudy itself is not installed, only what it needs: by its entry points."""
    try:
        importlib.metadata.distribution("understudy")
    except importlib.metadata.PackageNotFoundError:
        found = sorted((tree / "plugins").glob("*/*/understudy_*/__init__.py"))
        lines = [f"{f.parent.name.removeprefix('understudy_')} = {f.parent.name}" for f in found]
        info = tree / "kernel" / "understudy-0.dist-info"
        info.mkdir()
        (info / "METADATA").write_text("Metadata-Version: 2.1\nName: understudy\nVersion: 0\n")
        (info / "entry_points.txt").write_text("\n".join(["[understudy]", *lines]) + "\n")


def _run(tree: Path, tests: str, seconds: float, *more: str) -> Record:
    """The tests in the tree, with the outcome of each; all that they started is ended."""
    outcomes = tree / "outcomes"
    outcomes.unlink(missing_ok=True)
    scratch = tree / "tmp"
    shutil.rmtree(scratch, ignore_errors=True)
    scratch.mkdir()
    begin = time.monotonic()
    said = tree / "said"  # a file, not a pipe, which a process left behind would hold open
    with said.open("w", encoding="utf-8") as out:
        process = subprocess.Popen(
            [*command(tests), "-rs", "-p", "all_at_once", *more], cwd=tree, start_new_session=True,
            stdout=out, stderr=out, stdin=subprocess.DEVNULL,
            env={**environment(tree), _OUTCOMES: str(outcomes), "PYTEST_DEBUG_TEMPROOT": str(scratch)},
        )  # fmt: skip
    try:
        status: int | str = process.wait(seconds)
    except subprocess.TimeoutExpired:
        status = f"over {seconds:.0f} s"
    finally:
        with contextlib.suppress(ProcessLookupError):
            os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    text = said.read_text("utf-8", errors="replace")
    passed, other = set[str](), dict[str, str]()
    for line in outcomes.read_text("utf-8").splitlines() if outcomes.exists() else ():
        name, when, outcome = json.loads(line)
        if outcome != "passed":
            other[name] = "failed" if other.get(name) == "failed" else outcome
        elif when == "call":
            passed.add(name)
    missing = sorted(
        set(re.findall(r"No module named '([\w.]+)'|could not import '([\w.]+)'", text))
    )
    return {
        "status": status,
        "seconds": round(time.monotonic() - begin, 1),
        "passed": sorted(passed - other.keys()),
        "failed": sorted(name for name, outcome in other.items() if outcome == "failed"),
        "skipped": sorted(name for name, outcome in other.items() if outcome == "skipped"),
        "missing": sorted({a or b for a, b in missing}),
        "end": text[-600:],
    }


def verdict(all_guards: Record, without: Record | None) -> tuple[str, str]:
    """``noticed``, ``missed``, ``could not run`` or ``unclear``, and why.

    `all_guards` is what came of the mutant's tests with every guard in place; `without` is what came, without
    its guard, of those that had passed, None where there were none.
    """
    failed, skipped = len(all_guards["failed"]), len(all_guards["skipped"])
    lost = [f"{failed} of its tests fail anyway"] * bool(failed) + [
        f"{skipped} are skipped"
    ] * bool(skipped)
    if all_guards["missing"]:
        lost.append("not installed: " + ", ".join(all_guards["missing"]))
    why = ", ".join(lost)
    if without is None:
        return "could not run", why or f"no test of it ended (status {all_guards['status']})"
    status = without["status"]
    if status == 1 or (isinstance(status, int) and status < 0):  # a signal may have ended the tests
        return "noticed", (without["failed"] or [f"status {status}"])[0]
    if status == 0:
        return "missed", why
    return "unclear", f"status {status}"


class _Trees:
    """Copies of the tree, each for one job at a time."""

    def __init__(self, folder: Path, count: int) -> None:
        self._free: queue.Queue[Path] = queue.Queue()
        for number in range(count):
            tree = copy_of_the_tree(folder / f"tree{number}")
            _name_the_plugins(tree)
            self._free.put(tree)

    def use(self, do: Callable[[Path], Record]) -> Record:
        tree = self._free.get()
        try:
            return do(tree)
        finally:
            self._free.put(tree)


def main(arguments: list[str] | None = None) -> int:
    from mutants import MUTANTS, Mutant

    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--jobs", type=int, default=os.cpu_count(), help="tried at once")
    parser.add_argument("--out", type=Path, help="file of results, gone on with if it is there")
    parser.add_argument("-k", dest="word", default="", help="only mutants with this in their name")
    parser.add_argument("--seconds", type=float, default=1e9, help="begin nothing after so long")
    parser.add_argument("--limit", type=float, default=1500, help="seconds that one may take")
    chosen = parser.parse_args(arguments)
    wanted = [m for m in MUTANTS if chosen.word in m.name]
    begin, lock = time.monotonic(), threading.Lock()
    records: dict[str, Record] = {}
    if chosen.out is not None and chosen.out.exists():
        for line in chosen.out.read_text("utf-8").splitlines():
            records[json.loads(line)["of"]] = json.loads(line)

    def keep(of: str, record: Record) -> Record:
        with lock:
            records[of] = {"of": of, **record}
            if chosen.out is not None:
                with chosen.out.open("a", encoding="utf-8") as out:
                    out.write(json.dumps(records[of]) + "\n")
        return record

    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        trees = _Trees(Path(folder), chosen.jobs)

        def guarded(tests: str) -> Record:
            return keep(tests, trees.use(lambda tree: _run(tree, tests, chosen.limit)))

        def lost(mutant: Mutant) -> Record:
            first = records[mutant.tests]
            if not first["passed"]:
                outcome, why = verdict(first, None)
                return keep(mutant.name, {"verdict": outcome, "why": why, "seconds": 0})

            def do(tree: Path) -> Record:
                file = tree / mutant.file
                text = file.read_text(encoding="utf-8")
                file.write_text(text.replace(mutant.before, mutant.after), encoding="utf-8")
                without = [word for name in first["failed"] for word in ("--deselect", name)]
                try:
                    return _run(tree, mutant.tests, chosen.limit, "-x", *without)
                finally:
                    file.write_text(text, encoding="utf-8")

            done = trees.use(do)
            outcome, why = verdict(first, done)
            kept = {"verdict": outcome, "why": why, "seconds": done["seconds"]}
            return keep(mutant.name, kept if outcome == "noticed" else {**kept, "end": done["end"]})

        ended = itertools.count(1)

        def in_time(do: Callable[[Any], Record], one: Any) -> bool:
            if time.monotonic() - begin >= chosen.seconds:
                return False
            do(one)
            if (number := next(ended)) % 20 == 0:
                print(f"{time.monotonic() - begin:.0f} s: {number}", flush=True)
            return True

        of_tests: dict[str, list[Mutant]] = {}
        for mutant in wanted:
            of_tests.setdefault(mutant.tests, []).append(mutant)
        with ThreadPoolExecutor(chosen.jobs) as pool:
            waiting: set[Future[bool]] = set()
            first: dict[Future[bool], str] = {}
            for tests, those in of_tests.items():
                if tests not in records:
                    first[pool.submit(in_time, guarded, tests)] = tests
                else:
                    waiting |= {
                        pool.submit(in_time, lost, m) for m in those if m.name not in records
                    }
            waiting |= first.keys()
            while waiting:  # a mutant follows its tests, so that the slowest holds up no other
                done, waiting = wait(waiting, return_when=FIRST_COMPLETED)
                for future in done:
                    if future.result() and future in first:
                        waiting |= {pool.submit(in_time, lost, m) for m in of_tests[first[future]]}
        # What other jobs may have spoilt is tried again alone: a time limit, a memory.
        again = [
            m
            for m in wanted
            if m.tests in records
            and records.get(m.name, {}).get("verdict") in ("missed", "unclear", "could not run")
            and not records[m.name].get("alone")
            and not (records[m.tests]["missing"] and not records[m.tests]["passed"])
        ]

        def alone(mutant: Mutant) -> Record:
            guarded(mutant.tests)
            return keep(mutant.name, {**lost(mutant), "alone": True})

        if chosen.jobs > 1:
            for mutant in again:
                in_time(alone, mutant)

    tried = [(m, records[m.name]) for m in wanted if m.name in records]
    for mutant, record in tried:
        if record["verdict"] != "noticed":
            print(f"{record['verdict']:13} {mutant.name}: {mutant.tests} ({record['why']})")
    for tests in sorted({m.tests for m in wanted} & records.keys()):
        if records[tests]["failed"]:
            print(f"fails with all guards: {', '.join(records[tests]['failed'])}")
    count = Counter(record["verdict"] for _, record in tried)
    print(
        f"{len(wanted)} mutants: "
        + ", ".join(f"{count[w]} {w}" for w in ("noticed", "missed", "could not run", "unclear"))
        + f", {len(wanted) - len(tried)} not tried; {time.monotonic() - begin:.0f} s"
    )
    could = count["noticed"] + count["missed"] + count["unclear"]
    print(f"noticed of those that could run: {count['noticed']}/{could}")
    return int(count["noticed"] < len(wanted))


if __name__ == "__main__":
    sys.exit(main())
