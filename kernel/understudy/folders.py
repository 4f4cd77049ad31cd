"""Reading strangers' files safely: none outside a folder, none without end; writing ours whole."""

from __future__ import annotations

import contextlib
import errno
import io
import os
import stat
from collections.abc import Iterator
from pathlib import Path

from understudy.errors import RunError

__all__ = ["DOCUMENT", "check_within", "opened", "read", "sync", "write_atomically"]

DOCUMENT = 2**28  #: most bytes of a JSON file, such as ``run.json``
#: Errors of file systems without locks, or without a way to write to the disk at once.
UNSUPPORTED = (errno.ENOLCK, errno.ENOSYS, errno.EOPNOTSUPP, errno.EINVAL, errno.ENOTTY)


def check_within(folder: Path) -> None:
    """Check `folder` before anything in it is opened: a RunError names the first part that resolves
    outside of it, or is a pipe, a device or a socket."""
    top, waiting = os.path.realpath(folder), [os.fspath(folder)]
    try:
        while waiting:
            with contextlib.suppress(FileNotFoundError):  # which another process has just removed
                for entry in os.scandir(waiting.pop()):
                    with contextlib.suppress(FileNotFoundError):
                        mode = entry.stat(follow_symlinks=False).st_mode
                        if stat.S_ISDIR(mode):
                            waiting.append(entry.path)
                        elif stat.S_ISLNK(mode):
                            if os.path.commonpath([top, os.path.realpath(entry.path)]) != top:
                                raise RunError(
                                    f"{entry.path} is a link that leads out of {folder}. Put what it "
                                    "leads to in its place, or remove it."
                                )
                        elif not stat.S_ISREG(mode):
                            raise RunError(
                                f"{entry.path} is neither file nor folder. Name another folder."
                            )
    except OSError as error:
        raise RunError(f"{folder} cannot be read: {error.strerror}.") from error


def open_lock(path: Path) -> io.FileIO:
    """The lock file at `path`, made if there is none; an OSError if it is a link, or read-only."""
    flags = os.O_RDWR | os.O_CREAT | os.O_NOFOLLOW | os.O_NONBLOCK | os.O_CLOEXEC
    return io.FileIO(os.open(path, flags, 0o666), "r+")


@contextlib.contextmanager
def opened(path: Path, most: int = DOCUMENT) -> Iterator[io.BufferedReader]:
    """The file at `path`, open for reading; an OSError if it cannot be, is no file, or too large."""
    with open(os.open(path, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC), "rb") as file:
        found = os.fstat(file.fileno())
        if stat.S_ISDIR(found.st_mode):
            raise IsADirectoryError(errno.EISDIR, os.strerror(errno.EISDIR))
        if not stat.S_ISREG(found.st_mode):
            raise OSError(errno.EINVAL, "it is no file")
        if found.st_size > most:
            raise OSError(errno.EFBIG, f"it is larger than {most >> 20} MiB")
        yield file


def read(path: Path, most: int = DOCUMENT) -> bytes:
    """The content of a file; errors as of :func:`opened`."""
    with opened(path, most) as file:
        return file.read(most)


def sync(descriptor: int) -> None:
    """Force what was written onto the disk, if the file system can."""
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in UNSUPPORTED:
            raise


def write_atomically(path: Path, data: bytes) -> None:
    """Replace `path` with `data` so that a crash leaves either the old file or the new one. A
    RunError if the disk is full or the folder cannot be written; the old file is untouched."""
    temporary = path.parent / f".{path.name}.{os.getpid()}.partial"
    try:
        with open(temporary, "wb") as file:
            file.write(data)
            file.flush()
            sync(file.fileno())
        os.replace(temporary, path)
        folder = os.open(path.parent, os.O_RDONLY)
        try:
            sync(folder)
        finally:
            os.close(folder)
    except OSError as error:
        raise RunError(
            f"{path} could not be written: {error.strerror}. What was there is untouched."
        ) from error
    finally:
        with contextlib.suppress(OSError):  # it is there only if writing did not finish
            temporary.unlink()
