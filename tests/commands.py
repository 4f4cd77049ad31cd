"""The command line, and other code, in processes of their own: forks of a server that has imported everything,
so that they start at once."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Mapping, Sequence
from multiprocessing import connection, forkserver
from pathlib import Path
from typing import Any

from readers import leave_after
from worlds import child_environment

from understudy.command.cli import main
from understudy.setup.plugins import installed
from understudy.testing import check_plugin


def serve() -> Any:
    """The server, started if it is not; it finds what stands beside this file."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(["warm"])
    before = dict(os.environ)
    try:
        os.environ.update(child_environment())
        forkserver.ensure_running()
    finally:
        os.environ.clear()
        os.environ.update(before)
    return server


def serve_as_this() -> None:
    """Start the server as a fork of this process, which has imported what it needs."""
    addresses: Any = connection
    with socket.socket(socket.AF_UNIX) as listener:
        address = addresses.arbitrary_address("AF_UNIX")
        listener.bind(address)
        listener.listen()
        alive, ours = os.pipe()
        pid = os.fork()
        if pid == 0:
            os.close(ours)
            os.environ.update(child_environment())
            leave_after(lambda: forkserver.main(listener.fileno(), alive, []))  # type: ignore[attr-defined]
    os.close(alive)
    server: Any = forkserver._forkserver  # type: ignore[attr-defined]
    server._forkserver_address, server._forkserver_alive_fd = address, ours
    server._forkserver_pid = pid


def start(target: Callable[..., None], *arguments: Any) -> Any:
    """A process, a fork of the server, that calls `target`."""
    process = serve().Process(target=target, args=arguments)
    process.start()
    return process


def begin(*arguments: str) -> Any:
    """A process that carries out the command, in silence; its exit code is the command's status."""
    return start(_quietly, arguments)


def begin_on(terminal: Path, encoding: str, *arguments: str) -> Any:
    """As :func:`begin`, with what it prints in the file `terminal`, which takes `encoding` alone."""
    return start(_showing, terminal, encoding, arguments)


def _showing(terminal: Path, encoding: str, arguments: tuple[str, ...]) -> None:
    os.dup2(os.open(terminal, os.O_WRONLY | os.O_CREAT), 1)
    os.dup2(1, 2)
    sys.stdout = io.TextIOWrapper(io.FileIO(1, "w", closefd=False), encoding)
    sys.stderr = io.TextIOWrapper(io.FileIO(2, "w", closefd=False), encoding, "backslashreplace")
    sys.argv = ["understudy", *arguments]
    status = main()
    sys.stdout.flush()
    os._exit(status)


def begin_check(plugin: str, allowed: str) -> Any:
    """A process in which no plugin but those `allowed` is installed; it ends with exit code 0 if what `plugin`
    registers works."""
    return start(_checking, plugin, allowed)


def _checking(plugin: str, allowed: str) -> None:
    os.environ["UNDERSTUDY_PLUGINS"] = allowed
    installed.cache_clear()
    check_plugin(plugin)


def begin_that_stops_writing(mark: Path, *arguments: str) -> Any:
    """As :func:`begin`, of a command that writes `mark` and waits once its file's content is on disk under
    another name."""
    return start(_stopping, mark, arguments)


def _stopping(mark: Path, arguments: tuple[str, ...]) -> None:
    from understudy import folders

    def stop(handle: int) -> None:
        mark.touch()
        time.sleep(600)

    folders.sync = stop
    _quietly(arguments)


def _quietly(arguments: tuple[str, ...]) -> None:
    _hear_terminals()
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(null, stream)
    os._exit(main(list(arguments)))


def _hear_terminals() -> None:
    """Whoever started the server may have blocked what terminals send, or ignore it (``nohup``)."""
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGHUP})
    signal.signal(signal.SIGHUP, signal.SIG_DFL)


def begin_code(
    code: str, *arguments: str, cwd: Path, out: Path, err: Path, **environment: str
) -> Any:
    """A process that executes `code` as a program of these `arguments` in the folder `cwd`, with what it prints
    in the files `out` and `err`; a fresh interpreter but for what is imported already."""
    said = []
    for file in (out, err):
        file.touch()
        said.append(str(file))
    return start(_executing, code, arguments, str(cwd), said, child_environment(**environment))


def _executing(
    code: str, arguments: tuple[str, ...], cwd: str, said: list[str], environment: dict[str, str]
) -> None:
    _hear_terminals()
    installed.cache_clear()
    os.environ.clear()
    os.environ.update(environment)
    for stream, file in enumerate(said, 1):
        os.dup2(os.open(file, os.O_WRONLY | os.O_APPEND), stream)
    os.chdir(cwd)
    sys.argv = ["-c", *arguments]
    leave_after(lambda: exec(compile(code, "<string>", "exec"), {"__name__": "__main__"}))


def forked(
    code: str, *arguments: str, cwd: Path, seconds: float = 120.0, **environment: str
) -> subprocess.CompletedProcess[str]:
    """Carry `code` out as :func:`begin_code` does, to its end; as :func:`worlds.python`, for what does not
    ask how an interpreter starts."""
    together = forked_together(
        code, *arguments, cwd=cwd, environments=[environment], seconds=seconds
    )
    return together[0]


def forked_together(
    code: str,
    *arguments: str,
    cwd: Path,
    environments: Sequence[Mapping[str, str]],
    seconds: float = 120.0,
) -> list[subprocess.CompletedProcess[str]]:
    """As :func:`forked`, in as many processes side by side as there are `environments`."""
    with tempfile.TemporaryDirectory() as folder:
        said = [
            (Path(folder) / f"{i}.out", Path(folder) / f"{i}.err") for i in range(len(environments))
        ]
        processes = [
            begin_code(code, *arguments, cwd=cwd, out=out, err=err, **environment)
            for environment, (out, err) in zip(environments, said, strict=True)
        ]
        try:
            for process in processes:
                process.join(seconds)
                if process.is_alive():
                    raise subprocess.TimeoutExpired(code, seconds)
        finally:
            for process in processes:
                process.kill()
        return [
            subprocess.CompletedProcess(arguments, process.exitcode, *map(Path.read_text, files))
            for process, files in zip(processes, said, strict=True)
        ]


def wait_for(process: Any, there: Path, seconds: float = 60.0) -> None:
    """Until the file is there."""
    deadline = time.monotonic() + seconds
    while not there.exists():
        assert process.is_alive(), "it ended before it could be killed"
        assert time.monotonic() < deadline
        time.sleep(0.002)


def kill(process: Any) -> None:
    os.kill(process.pid, signal.SIGKILL)
    process.join()
    assert process.exitcode == -signal.SIGKILL


def begin_reproduction(table: Path, *arguments: str) -> Any:
    """As :func:`begin`, of ``reproduce`` where the file `table` is the table ``mine/one``."""
    return start(_offering, table, arguments)


def _offering(table: Path, arguments: tuple[str, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # else an error of Python's until our first line
    from understudy_reproduce import command, tables

    modules: list[Any] = [tables, command]
    for module in modules:
        module.table_files = lambda plugins: {"mine/one": table}
    _quietly(arguments)
