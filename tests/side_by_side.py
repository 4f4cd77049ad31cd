"""All tests of ``make test``, in two processes side by side.

Not pytest-xdist: its workers take signals that the tests of stop signals send. A group is a process of its
own, so nothing is shared but the machine; what it prints is shown when it ends. There are no more groups than
processors: each imports everything once, starts servers of its own, and makes anew what several tests share::

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
#: How many times as long as others of as many lines these take, so that groups end together.
SLOWER = {
    "cloth": 2, "cmfbo": 2, "diversity": 3, "dressing": 3, "external": 5, "humanoid": 2, "integration": 2,
    "miniature": 3, "mujoco_on_warp": 3, "play": 2, "pose_vae": 2, "ppo": 2, "ray_executor": 3, "sitting": 2,
    "test_capturable.py": 30, "test_docs.py": 2, "test_experiments.py": 4, "test_isolation.py": 3,
    "test_parts_and_tasks.py": 15, "test_quick.py": 6,
}  # fmt: skip
#: These make the same stages (``miniatures.make_stages``), once a process.
TOGETHER = {"miniature", "sequencing", "skills", "test_parts_and_tasks.py"}
_PR_SET_CHILD_SUBREAPER = 36  #: of <linux/prctl.h>


def groups() -> list[list[Path]]:
    """What each process runs; together it is everything in ``tests``."""
    dealt: list[list[Path]] = [[] for _ in range(SIDE_BY_SIDE)]
    sizes = [0] * SIDE_BY_SIDE
    found = [*TESTS.iterdir(), *(TESTS / "plugins").iterdir()]
    found = [path for path in sorted(found) if is_tests(path) and path.name != "plugins"]
    together = [path for path in found if path.name in TOGETHER]
    dealt_out = [together, *([path] for path in found if path not in together)]
    for paths in sorted(dealt_out, key=lambda paths: -sum(map(size, paths))):
        least = sizes.index(min(sizes))
        dealt[least] += paths
        sizes[least] += sum(map(size, paths))
    return [sorted(group) for group in dealt]


def is_tests(path: Path) -> bool:
    if path.is_dir():
        return any(path.rglob("test_*.py"))
    return path.match("test_*.py")


def size(path: Path) -> int:
    """Lines of its tests, weighted by how long such lines take."""
    files = path.rglob("test_*.py") if path.is_dir() else [path]
    lines = sum(len(file.read_bytes().splitlines()) for file in files)
    return lines * SLOWER.get(path.name, 1)


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
