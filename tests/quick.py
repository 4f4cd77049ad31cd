"""What most likely breaks by the change at hand, within a minute on two cores (``make quick``).

One smoke of each wing of plugins, then the tests nearest to what changed, nearest first, in two processes. What
changed is what git says of the working tree, or of its last commit if nothing is changed. When the time is over,
what runs is stopped and counted with what was not reached; ``make test`` runs everything::

    python tests/quick.py [FILE …]      # as if these files had changed
"""

from __future__ import annotations

import os
import re
import signal
import subprocess
import sys
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from types import FrameType

import pytest

TESTS = Path(__file__).resolve().parent
ROOT = TESTS.parent
SECONDS = 60
#: s: left for ruff before it, and for what ends a run: reports, temporary folders.
SPARE = 12
#: One smoke of each wing: a part of it does what it is for, in a few seconds.
SMOKES = {
    "physics": "plugins/mujoco/test_simulator.py::test_falls_as_the_physics_says",
    "learning": "plugins/ppo/test_learner.py::test_first_step_ratio_is_one",
    "figures": "plugins/humanoid/test_character.py::test_a_standing_target_holds_it_upright",
    "showing": "plugins/report/test_stick_figures.py",
    "studio": "plugins/doctor/test_flight_check.py",
    "search": "plugins/sweeps/test_grid.py",
    "papers": "plugins/spacetime/test_bounds.py",
}
#: What every page is held to: its figures are its records', its links lead somewhere, its commands compose.
PAGES = ("test_docs.py", "test_figures.py")
#: Folders of tests that are not in the folder of their plugin's name.
ELSEWHERE = {"mujoco_warp": "mujoco_on_warp"}


def changed() -> list[Path]:
    """What git says has changed: of the working tree, else of the last commit."""

    def git(*arguments: str) -> list[str]:
        done = subprocess.run(["git", *arguments], cwd=ROOT, capture_output=True, text=True)
        return done.stdout.splitlines()

    files = git("diff", "--name-only", "HEAD") + git("ls-files", "--others", "--exclude-standard")
    files = files or git("diff", "--name-only", "HEAD~1", "HEAD")
    return [ROOT / file for file in files]


def room(path: Path) -> Path:
    """The folder of tests that mirrors where `path` stands, or ``tests`` where none does."""
    parts = path.relative_to(ROOT).parts
    if parts[0] == "plugins" and len(parts) > 3:
        return TESTS / "plugins" / ELSEWHERE.get(parts[2], parts[2])
    if parts[0] == "kernel":
        folder = TESTS.joinpath("kernel", *parts[2:-1])
        return folder if folder.is_dir() else TESTS / "kernel"
    return TESTS


def nearest(files: Sequence[Path]) -> list[Path]:
    """Modules of tests, nearest to `files` first: what changed itself, what has a module's name, what imports
    it, what is in the same room."""
    modules = {file: file.read_text(encoding="utf-8") for file in sorted(TESTS.rglob("test_*.py"))}
    distances: dict[Path, int] = {}

    def note(module: Path, distance: int) -> None:
        distances[module] = min(distance, distances.get(module, distance))

    for file in files:
        if file in modules:
            note(file, 0)
            continue
        if not file.is_relative_to(ROOT):
            continue
        if file.suffix == ".md":
            for module in PAGES:
                note(TESTS / module, 3)
            continue
        own, stem = room(file), file.stem.strip("_")
        dotted = re.sub(
            r"^(kernel|plugins\.\w+\.\w+)\.",
            "",
            ".".join(file.relative_to(ROOT).with_suffix("").parts),
        )
        names = re.compile(rf"\b{re.escape(dotted)}\b") if file.suffix == ".py" else None
        for module, text in modules.items():
            inside = own != TESTS and module.is_relative_to(own)
            if inside and stem and stem in module.stem:
                note(module, 1)
            elif names and names.search(text):
                note(module, 2)
            elif inside:
                note(module, 3)
    return sorted(distances, key=lambda module: (distances[module], str(module)))


class Clock:
    """Stops the test that runs, and lets none begin, once it is `until` (s, ``time.time``)."""

    def __init__(self, until: float) -> None:
        self._until = until
        self.unreached = 0

    def _late(self, number: int, frame: FrameType | None) -> None:
        pytest.skip("the time is over")

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_setup(self) -> Iterator[None]:
        yield from self._within()

    @pytest.hookimpl(wrapper=True)
    def pytest_runtest_call(self) -> Iterator[None]:
        yield from self._within()

    def _within(self) -> Iterator[None]:
        before = signal.signal(signal.SIGALRM, self._late)  # pytest-timeout's, which says later
        signal.setitimer(signal.ITIMER_REAL, max(0.01, self._until - time.time()))
        try:
            yield
        finally:
            signal.setitimer(signal.ITIMER_REAL, 0)
            signal.signal(signal.SIGALRM, before)

    @pytest.hookimpl(tryfirst=True)
    def pytest_runtest_protocol(self, item: pytest.Item) -> bool | None:
        if time.time() < self._until:
            return None
        self.unreached += 1
        return True

    def pytest_terminal_summary(self, terminalreporter: pytest.TerminalReporter) -> None:
        if self.unreached:
            terminalreporter.write_line(f"{self.unreached} further tests were not reached in time")


def run(until: float, tests: list[str]) -> int:
    """One of the processes: these tests, until it is `until`."""
    code = pytest.main(["-q", "-p", "no:cacheprovider", *tests], plugins=[Clock(until)])
    return 0 if code == pytest.ExitCode.NO_TESTS_COLLECTED else int(code)


def main(arguments: list[str]) -> int:
    if arguments[:1] == ["--until"]:
        return run(float(arguments[1]), arguments[2:])
    until = time.time() + SECONDS - SPARE
    near = [str(m) for m in nearest([Path(a).resolve() for a in arguments] or changed())]
    smokes = [str(TESTS / test) for test in SMOKES.values()]
    halves = [smokes[::2] + near[::2], smokes[1::2] + near[1::2]]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # a core for each process
    started = [
        subprocess.Popen(
            [sys.executable, __file__, "--until", str(until), *half],
            cwd=ROOT, env=environment, text=True, stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        )
        for half in halves
    ]  # fmt: skip
    for process in started:
        print(process.communicate()[0], flush=True)
    return int(any(process.returncode for process in started))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
