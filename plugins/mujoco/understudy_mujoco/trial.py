"""A stranger's model is first compiled in a process of its own, within bounds.

A few bytes of MJCF (``replicate``, ``lengthrange``, ``nkey``) have MuJoCo compute for hours or allocate
without end, and an exception within it (MuJoCo 4.0) leaves the thread's log handler pointing at itself:
the next warning never returns. What ends here costs that process alone.
"""

from __future__ import annotations

import hashlib
import resource
import signal
import subprocess
import sys
from pathlib import Path

import mujoco

from understudy.errors import FileError
from understudy_mujoco.mjcf import Mjcf, read_mjcf

CPU_SECONDS = 60
"""Of processor time, for reading and compiling a model."""
WALL_SECONDS = 600
MEMORY = 4 * 2**30
"""Bytes of address space."""

_REFUSED = 3
_passed: set[bytes] = set()


def try_out(path: Path, model: Mjcf) -> None:
    """Compile the model at `path`, once for what `model` holds of it.

    Raises:
        FileError: it does not compile, or not within the bounds.
    """
    digest = hashlib.sha256(model.text.encode())
    for name, content in sorted(model.assets.items()):
        digest.update(f"\0{name}\0{len(content)}\0".encode() + content)
    if digest.digest() in _passed:
        return
    # not from the working folder (-P), and not ended by the terminal's signals, which are ours to see to
    command = [sys.executable, "-P", "-m", __name__, str(path), str(CPU_SECONDS), str(MEMORY)]
    try:
        done = subprocess.run(
            command, capture_output=True, start_new_session=True, timeout=WALL_SECONDS
        )
    except subprocess.TimeoutExpired as error:
        raise FileError(_beyond(path, f"{WALL_SECONDS} s")) from error
    if done.returncode == _REFUSED:
        raise FileError(done.stdout.decode(errors="replace").strip())
    if done.returncode in (-signal.SIGXCPU, -signal.SIGKILL):
        raise FileError(_beyond(path, f"{CPU_SECONDS} s of processor time"))
    if done.returncode:
        raise FileError(
            f"The model {path} does not compile: it ends MuJoCo (status {done.returncode})."
        )
    _passed.add(digest.digest())


def _beyond(path: Path, bound: str) -> str:
    return f"The model {path} does not compile within {bound}; make it smaller."


def attempt(path: Path) -> None:
    """Read and compile the model at `path` in this process.

    Raises:
        FileError: it does not load or compile.
    """
    model = read_mjcf(path)
    doing = "load"
    try:
        spec = mujoco.MjSpec.from_string(model.text, assets=dict(model.assets))
        doing = "compile"
        spec.compile()
    except (ValueError, RuntimeError, mujoco.FatalError, MemoryError) as error:
        said = str(error).strip().partition("\n")[0]
        if not said or said == "Caught an unknown exception!":
            said = "MuJoCo gives no reason, which may be that it needs more memory."
        raise FileError(f"The model {path} does not {doing}: {said}") from error


if __name__ == "__main__":
    seconds, memory = map(int, sys.argv[2:])
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    resource.setrlimit(resource.RLIMIT_CPU, (seconds, seconds + 5))
    resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
    try:
        attempt(Path(sys.argv[1]))
    except FileError as error:
        print(error)
        sys.exit(_REFUSED)
