"""Reading strangers' models and meshes in a process each, as the product does, but forks of one that has imported
what readers need: a third of a second of processor time less for each.

What a fork reads, prints, and how it ends is as of ``python -P -m MODULE``; the limits, the session and the environment
are its own. What asks how an interpreter starts takes :func:`subprocess.run` itself (the fixture ``fresh_readers``).
"""

from __future__ import annotations

import atexit
import contextlib
import functools
import json
import os
import runpy
import select
import signal
import socket
import subprocess
import sys
import tempfile
import traceback
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NoReturn

_FOUR_FILES = 4  #: standard input, output and error, and where to say how it ended
_MESSAGE = 2**20  #: bytes


@functools.cache
def server() -> socket.socket:
    """The socket of the server, which ends when this process does. It has no environment but its start's."""
    ours, its = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    subprocess.Popen(
        [sys.executable, "-P", __file__], stdin=its.fileno(), stdout=subprocess.DEVNULL,
        env={**os.environ, "OPENBLAS_NUM_THREADS": "1"}, start_new_session=True,
    )  # fmt: skip
    its.close()
    atexit.register(ours.close)
    return ours


def run(
    command: Sequence[str], *, input: bytes, capture_output: bool, start_new_session: bool,
    timeout: float, env: Mapping[str, str],
) -> subprocess.CompletedProcess[bytes]:  # fmt: skip
    """As :func:`subprocess.run`, of what ``read_apart`` gives it."""
    program, flag, of, module, *arguments = command
    assert (program, flag, of) == (sys.executable, "-P", "-m")
    assert capture_output
    assert start_new_session
    with (
        tempfile.TemporaryFile() as given,
        tempfile.TemporaryFile() as out,
        tempfile.TemporaryFile() as err,
    ):
        given.write(input)
        given.seek(0)
        heard, told = socket.socketpair()
        with heard:
            with told:
                asked = json.dumps([module, arguments, dict(env), os.getcwd()]).encode()
                files = [given.fileno(), out.fileno(), err.fileno(), told.fileno()]
                socket.send_fds(server(), [asked], files)
            pid = int.from_bytes(heard.recv(8), "little")
            heard.settimeout(timeout)
            try:
                status = int.from_bytes(heard.recv(8), "little")
            except BaseException as error:
                os.kill(pid, 9)
                if isinstance(error, TimeoutError):
                    raise subprocess.TimeoutExpired(command, timeout) from None
                raise
        said = []
        for file in (out, err):
            file.seek(0)
            said.append(file.read())
    return subprocess.CompletedProcess(command, os.waitstatus_to_exitcode(status), *said)


def _serve() -> None:
    """The server: a fork for each request."""
    import mujoco  # noqa: F401
    import numpy  # noqa: F401
    import scipy.spatial  # noqa: F401
    import trimesh  # noqa: F401

    import understudy_characters  # noqa: F401
    import understudy_mujoco.apart
    import understudy_mujoco.mjcf  # noqa: F401

    requests, (woken, wakes) = socket.socket(fileno=os.dup(0)), socket.socketpair()
    wakes.setblocking(False)
    signal.signal(signal.SIGCHLD, lambda number, frame: None)
    signal.set_wakeup_fd(wakes.fileno(), warn_on_full_buffer=False)
    running: dict[int, socket.socket] = {}
    while True:
        ready, _, _ = select.select([requests, woken], [], [])
        if woken in ready:
            woken.recv(_MESSAGE)
            _tell_of_ends(running)
        if requests not in ready:
            continue
        asked, files, *_ = socket.recv_fds(requests, _MESSAGE, _FOUR_FILES)
        if not asked:
            return
        child = os.fork()
        if child == 0:
            _become(files[:3], *json.loads(asked))
        running[child] = told = socket.socket(fileno=files[3])
        told.send(child.to_bytes(8, "little"))
        for file in files[:3]:
            os.close(file)


def _tell_of_ends(running: dict[int, socket.socket]) -> None:
    """Say of each process that ended how it did, to whoever asked for it."""
    while running:
        child, status = os.waitpid(-1, os.WNOHANG)
        if child == 0:
            return
        with contextlib.suppress(BrokenPipeError), running.pop(child) as told:
            told.send(status.to_bytes(8, "little"))


def _become(
    files: list[int], module: str, arguments: list[str], environment: dict[str, str], folder: str
) -> NoReturn:
    signal.set_wakeup_fd(-1)
    signal.signal(signal.SIGCHLD, signal.SIG_DFL)
    os.setsid()
    for stream, file in enumerate(files):
        os.dup2(file, stream)
    os.closerange(3, 1024)
    os.chdir(folder)
    os.environ.clear()
    os.environ.update(environment)
    sys.argv = [module, *arguments]
    leave_after(lambda: runpy.run_module(module, run_name="__main__", alter_sys=True))


def leave_after(work: Callable[[], object]) -> NoReturn:
    """Ends a forked process with the status that an interpreter has which did this `work`, none of the parent's at exit."""
    status: Any = 0
    try:
        work()
    except SystemExit as end:
        status = end.code if isinstance(end.code, int) else int(end.code is not None)
    except BaseException:
        traceback.print_exc()
        status = 1
    sys.stdout.flush()
    sys.stderr.flush()
    os._exit(status)


if __name__ == "__main__":
    _serve()
