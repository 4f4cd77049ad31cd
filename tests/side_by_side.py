"""All tests of ``make test``, in as many processes as there are groups at hand, two at a time.

Not pytest-xdist: its workers take signals that the tests of stop signals send. A group is a process of its
own, so nothing is shared but the machine; what it prints is shown when it ends::

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
#: What takes long by itself.
LONG = ("faults",)
#: The plugins' folders are dealt to so many groups. Each group more takes some 11 s: it imports everything, and so do its
#: servers, whose forks read strangers' files and carry out commands; and it makes the miniatures that others build on.
PLUGIN_GROUPS = 2
_PR_SET_CHILD_SUBREAPER = 36  #: of <linux/prctl.h>


def groups() -> list[list[Path]]:
    """What each process runs, what takes longest first; together it is everything in ``tests``."""
    plugins: list[list[Path]] = [[] for _ in range(PLUGIN_GROUPS)]
    sizes = [0] * PLUGIN_GROUPS
    found = [path for path in (TESTS / "plugins").iterdir() if is_tests(path)]
    for path in sorted(found, key=lines, reverse=True):
        least = sizes.index(min(sizes))
        plugins[least].append(path)
        sizes[least] += lines(path)
    rest = [p for p in TESTS.iterdir() if is_tests(p) and p.name not in (*LONG, "plugins")]
    return [*plugins, *([TESTS / name] for name in LONG), sorted(rest)]


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
    waiting, failed, lock = groups(), [], threading.Lock()
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}  # a core for each process
    environment.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes read the same files

    def work() -> None:
        while True:
            with lock:
                if not waiting:
                    return
                group = waiting.pop(0)
            command = [sys.executable, "-m", "pytest", *options, *map(str, group)]
            done = subprocess.run(
                command, cwd=TESTS.parent, env=environment, text=True, stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE, stderr=subprocess.STDOUT,
            )  # fmt: skip
            with lock:
                print(done.stdout, flush=True)
                if done.returncode not in (0, 5):  # 5: no test of it was asked for
                    failed.append(group)

    workers = [threading.Thread(target=work) for _ in range(SIDE_BY_SIDE)]
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
