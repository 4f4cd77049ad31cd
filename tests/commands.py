"""The command line in processes of its own, forks of a server that has imported everything, so that
they start at once."""

from __future__ import annotations

import io
import multiprocessing
import os
import signal
import sys
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

from understudy.command.cli import main
from understudy.testing import check_plugin

#: What the server has imported: of libraries whatever takes long, of plugins what trainings need.
_PRELOADED = ["torch._dynamo", "understudy_ppo.learner", "understudy.testing", "commands"]

Start = Callable[..., Any]


def begin(*arguments: str) -> Any:
    """A process that carries out the command, in silence; its exit code is the command's status."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(_PRELOADED)
    process = server.Process(target=_quietly, args=(arguments,))
    process.start()
    return process


def begin_on(terminal: Path, encoding: str, *arguments: str) -> Any:
    """As :func:`begin`, with what it prints in the file `terminal`, which takes `encoding` alone."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(_PRELOADED)
    process = server.Process(target=_showing, args=(terminal, encoding, arguments))
    process.start()
    return process


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
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(_PRELOADED)
    process = server.Process(target=_checking, args=(plugin, allowed))
    process.start()
    return process


def _checking(plugin: str, allowed: str) -> None:
    import torch

    torch.set_num_threads(1)
    os.environ["UNDERSTUDY_PLUGINS"] = allowed
    check_plugin(plugin)


def begin_that_stops_writing(mark: Path, *arguments: str) -> Any:
    """As :func:`begin`, of a command that writes `mark` and waits once its file's content is on disk under
    another name."""
    server = multiprocessing.get_context("forkserver")
    process = server.Process(target=_stopping, args=(mark, arguments))
    process.start()
    return process


def _stopping(mark: Path, arguments: tuple[str, ...]) -> None:
    from understudy.records import checkpoint

    def stop(handle: int) -> None:
        mark.touch()
        time.sleep(600)

    checkpoint.sync = stop
    _quietly(arguments)


def _quietly(arguments: tuple[str, ...]) -> None:
    import torch

    torch.set_num_threads(1)
    # Whoever started the server may have blocked what terminals send.
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT, signal.SIGHUP})
    null = os.open(os.devnull, os.O_WRONLY)
    for stream in (1, 2):
        os.dup2(null, stream)
    os._exit(main(list(arguments)))


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
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(_PRELOADED)
    process = server.Process(target=_offering, args=(table, arguments))
    process.start()
    return process


def _offering(table: Path, arguments: tuple[str, ...]) -> None:
    signal.signal(signal.SIGINT, signal.SIG_DFL)  # else an error of Python's until our first line
    from understudy_reproduce import command, tables

    modules: list[Any] = [tables, command]
    for module in modules:
        module.table_files = lambda plugins: {"mine/one": table}
    _quietly(arguments)
