"""Rows of JSON lines that cannot be read: they are left out, kept in a file beside it, and reported."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from understudy.command.command import tell
from understudy.folders import read, write_atomically

__all__ = ["leave_out"]

_MOST = 2**31  #: bytes of what was left out so far


def leave_out(path: Path, rows: Iterable[bytes], after: str = "") -> None:
    """Append `rows` of the file `path` that will be left out to ``NAME.left-out`` beside it, and say so; `after` says what
    follows. Blank lines are no rows. A crash cuts rows short, and other versions write other rows.

    Raises
    ------
    RunError
        they cannot be kept, so nothing may be left out.
    """
    lost = [row.strip() for row in rows if row.strip()]
    if not lost:
        return
    beside = path.with_name(f"{path.name}.left-out")
    earlier = read(beside, _MOST) if beside.exists() else b""
    kept = [row for row in lost if row not in earlier.splitlines()]
    if kept:
        write_atomically(beside, earlier + b"".join(row + b"\n" for row in kept))
    what, they = ("A row is", "It is") if len(lost) == 1 else (f"{len(lost)} rows are", "They are")
    tell(f"{what} damaged in {path} and left out{after}. {they} kept in {beside.name} beside it.")
