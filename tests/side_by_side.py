"""All tests of ``make test``, in two processes side by side, about half of them each.

Not pytest-xdist: its workers take signals that the tests of stop signals send. No more processes than that: each
imports everything, starts the servers that tests fork from, and settles garments and generates clips once. A line of
progress is shown when it is whole; what is said of failures, when the process ends::

    python tests/side_by_side.py [options of pytest]
"""

from __future__ import annotations

import contextlib
import ctypes
import os
import resource
import subprocess
import sys
import threading
import time
from pathlib import Path

TESTS = Path(__file__).resolve().parent
SIDE_BY_SIDE = 2
_PR_SET_CHILD_SUBREAPER = 36  #: of <linux/prctl.h>


def groups() -> list[list[Path]]:
    """What each process runs, about as many lines; together it is everything in ``tests``."""
    dealt: list[list[Path]] = [[] for _ in range(SIDE_BY_SIDE)]
    sizes = [0] * SIDE_BY_SIDE
    found = [*TESTS.iterdir(), *(TESTS / "plugins").iterdir()]
    tests = [path for path in found if is_tests(path) and path.name != "plugins"]
    for path in sorted(tests, key=lambda path: (-lines(path), path)):
        least = sizes.index(min(sizes))
        dealt[least].append(path)
        sizes[least] += lines(path)
    return [sorted(group) for group in dealt]


def is_tests(path: Path) -> bool:
    if path.is_dir():
        return any(path.rglob("test_*.py"))
    return path.match("test_*.py")


def lines(path: Path) -> int:
    files = path.rglob("test_*.py") if path.is_dir() else [path]
    return sum(len(file.read_bytes().splitlines()) for file in files)


def adopt_orphans() -> None:
    """On Linux: servers that outlive the tests that they fork for become this process's children, and count."""
    if sys.platform == "linux":
        ctypes.CDLL(None).prctl(_PR_SET_CHILD_SUBREAPER, 1, 0, 0, 0)


def processor_seconds() -> float:
    """Of all that was started here and has ended; user's and system's. Servers end soon after their tests."""
    with contextlib.suppress(ChildProcessError):
        until = time.monotonic() + 10.0
        while time.monotonic() < until:
            if os.waitpid(-1, os.WNOHANG) == (0, 0):
                time.sleep(0.1)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def main(options: list[str]) -> int:
    adopt_orphans()
    failed, lock = [], threading.Lock()
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # a core for each process
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes read the same files

    def work(group: list[Path]) -> None:
        command = [sys.executable, "-m", "pytest", *options, *map(str, group)]
        said = []
        with subprocess.Popen(
            command, cwd=TESTS.parent, env=environment, text=True, stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
        ) as process:  # fmt: skip
            assert process.stdout is not None
            for line in process.stdout:
                if said or (line.startswith("====") and "test session starts" not in line):
                    said.append(line)
                else:
                    print(line, end="", flush=True)
        with lock:
            print(*said, sep="", flush=True)
            if process.returncode not in (0, 5):  # 5: no test of it was asked for
                failed.append(group)

    workers = [threading.Thread(target=work, args=(group,)) for group in groups()]
    for worker in workers:
        worker.start()
    for worker in workers:
        worker.join()
    print(f"processor time: {processor_seconds():.0f} s")
    for group in failed:
        print("failed:", *(path.relative_to(TESTS.parent) for path in group))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
