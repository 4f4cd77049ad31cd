"""Reading a stranger's file in a process of its own, within limits: what ends there costs that process alone."""

from __future__ import annotations

import os
import resource
import signal
import subprocess
import sys
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from understudy.errors import FileError

__all__ = ["Limits", "read_apart", "serve"]

_REFUSED = 3


@dataclass(frozen=True)
class Limits:
    """What a process may take."""

    cpu: int = 60  #: s of processor time
    wall: int = 600  #: s of the clock
    memory: int = 4 * 2**30  #: bytes of address space


def read_apart(
    module: str, path: Path, refusal: str, limits: Limits, content: bytes = b""
) -> bytes:
    """What the program `module`, which calls :func:`serve`, prints of the file `path`.

    `refusal` begins the sentence about a file that its reader does not get through ("The mesh FILE
    cannot be read"); `content` is the program's standard input.

    Raises
    ------
    FileError
        if it refuses the file, or ends in any other way.
    """
    # not from the working folder (-P), and not ended by the terminal's signals, which are ours to see to
    command = [sys.executable, "-P", "-m", module, str(path), str(limits.cpu), str(limits.memory)]
    alone = {**os.environ, "OPENBLAS_NUM_THREADS": "1"}  # its threads would take address space
    try:
        done = subprocess.run(
            command, input=content, capture_output=True, start_new_session=True,
            timeout=limits.wall, env=alone,
        )  # fmt: skip
    except subprocess.TimeoutExpired as error:
        raise FileError(f"{refusal} within {limits.wall} s; make it smaller.") from error
    if done.returncode == _REFUSED:
        raise FileError(done.stdout.decode(errors="replace").strip())
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise FileError(f"{refusal} within {limits.cpu} s of processor time; make it smaller.")
    if done.returncode:
        raise FileError(f"{refusal}: it ends its reader (status {done.returncode}).")
    return done.stdout


def serve(read: Callable[[Path], str]) -> None:
    """The program: print what `read` makes of the file of the command line, within the limits given there."""
    cpu, memory = map(int, sys.argv[2:])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (cpu, cpu + 5))
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    try:
        print(read(Path(sys.argv[1])))
    except FileError as error:
        print(error)
        sys.exit(_REFUSED)
