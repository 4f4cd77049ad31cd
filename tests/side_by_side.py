"""All tests of ``make test``, in as many processes as there are groups at hand, two at a time.

Not pytest-xdist: its workers take signals that the tests of stop signals send. A group is a process of its
own, a fork of this one, which has imported what all of them need; what it prints is shown when it ends::

    python tests/side_by_side.py [options of pytest]
"""

from __future__ import annotations

import contextlib
import ctypes
import gc
import importlib
import os
import resource
import runpy
import sys
import tempfile
import time
from pathlib import Path
from typing import IO

TESTS = Path(__file__).resolve().parent
SIDE_BY_SIDE = 2
#: What takes long by itself.
LONG = ("faults",)
#: The plugins' folders are dealt to so many groups. Each group more makes the miniatures that others build on once more.
PLUGIN_GROUPS = 2
#: Kinds of parts for libraries that a test does without: they are imported where they are first needed.
WITHOUT = ("executor", "outer_loop", "sweep_page")
#: What takes a second to import, and several groups need and no test does without; the parts that use it are not imported.
LIBRARIES = ("mujoco_warp", "ribs.archives", "ribs.emitters")
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
    """Of this process, and of all that was started here and has ended; user's and system's. Servers end soon after
    their tests."""
    with contextlib.suppress(ChildProcessError):
        until = time.monotonic() + 10.0
        while time.monotonic() < until:
            if os.waitpid(-1, os.WNOHANG) == (0, 0):
                time.sleep(0.1)
    used = map(resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return sum(each.ru_utime + each.ru_stime for each in used)


def prepare() -> None:
    """Import what groups need, and start the server whose forks read strangers' files, once for all of them."""
    os.environ["OMP_NUM_THREADS"] = "1"  # a core for each process
    os.environ.pop("PYTHONDONTWRITEBYTECODE", None)  # hundreds of processes read the same files
    sys.dont_write_bytecode = False
    import readers

    readers.server()
    import warm  # noqa: F401
    from hypothesis import configuration, given, settings, strategies

    from understudy.setup.plugins import installed

    for component in installed().registry.components.values():
        if component.kind in WITHOUT:
            continue
        with contextlib.suppress(Exception):  # one that cannot be imported is for its test to say
            _ = component.factory
    for library in LIBRARIES:
        with contextlib.suppress(ImportError):
            importlib.import_module(library)
    # hypothesis looks through all of Unicode and all modules, once it draws texts and many numbers
    drawing = given(strategies.text(), strategies.lists(strategies.integers(), min_size=200))
    settings(max_examples=2, database=None, derandomize=True)(drawing(lambda text, numbers: None))()
    configuration.notice_initialization_restarted(warn=False)  # its plugin of pytest would
    gc.freeze()


def begin(group: list[Path], options: list[str], said: IO[str]) -> int:
    """The process of a group, as of ``python -m pytest``, which prints into `said`."""
    pid = os.fork()
    if pid:
        return pid
    import commands

    with open(os.devnull) as nothing:
        os.dup2(nothing.fileno(), 0)
    os.dup2(said.fileno(), 1)
    os.dup2(said.fileno(), 2)
    commands.serve_as_this()
    os.chdir(TESTS.parent)
    sys.path[0] = str(TESTS.parent)
    # what has been imported already cannot be looked through for asserts, and has none
    quiet = [
        "-W",
        "ignore:Module already imported so cannot be rewritten:pytest.PytestAssertRewriteWarning",
    ]
    sys.argv = ["pytest", *quiet, *options, *map(str, group)]
    runpy.run_module("pytest", run_name="__main__", alter_sys=True)
    sys.exit("pytest came to no end")


def main(options: list[str]) -> int:
    adopt_orphans()
    prepare()
    import readers

    waiting, failed = groups(), []
    running: dict[int, tuple[list[Path], IO[str]]] = {}
    while waiting or running:
        while waiting and len(running) < SIDE_BY_SIDE:
            group, said = waiting.pop(0), tempfile.TemporaryFile("w+")  # noqa: SIM115 - read when it ends
            running[begin(group, options, said)] = group, said
        pid, status = os.wait()
        if pid not in running:  # a server's
            continue
        group, said = running.pop(pid)
        with said:
            said.seek(0)
            print(said.read(), flush=True)
        if os.waitstatus_to_exitcode(status) not in (0, 5):  # 5: no test of it was asked for
            failed.append(group)
    readers.server().close()
    print(f"processor time: {processor_seconds():.0f} s")
    for group in failed:
        print("failed:", *(path.relative_to(TESTS.parent) for path in group))
    return int(bool(failed))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
