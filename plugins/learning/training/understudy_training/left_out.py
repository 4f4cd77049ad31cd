"""Rows of JSON lines that cannot be read: they are left out, kept in a file beside it, and reported."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

from understudy.command.command import tell
from understudy.folders import read, write_atomically

__all__ = ["leave_out", "not_counted"]

_MOST = 2**31  #: bytes of what was left out so far


def leave_out(path: Path, rows: Iterable[bytes], after: str = "") -> None:
    """Append `rows` of the file `path` that will be left out to ``NAME.left-out`` beside it, and say so; `after` says what
    follows. Blank lines are no rows. A crash cuts rows short, and other versions write other rows.

    Raises
    ------
    RunError
        they cannot be kept, so nothing may be left out.
    """
    lost = _rows(rows)
    if not lost:
        return
    beside = path.with_name(f"{path.name}.left-out")
    earlier = read(beside, _MOST) if beside.exists() else b""
    kept = [row for row in lost if row not in earlier.splitlines()]
    if kept:
        write_atomically(beside, earlier + b"".join(row + b"\n" for row in kept))
    they = "It is" if len(lost) == 1 else "They are"
    tell(f"{_damaged(lost)} in {path} and left out{after}. {they} kept in {beside.name} beside it.")


def not_counted(path: Path, rows: Iterable[bytes]) -> None:
    """Say that `rows` of the file `path`, which is only read, are left out. Blank lines are no rows."""
    if lost := _rows(rows):
        tell(f"{_damaged(lost)} in {path} and left out: what such a row told of is not counted.")


def _rows(lines: Iterable[bytes]) -> list[bytes]:
    return [line.strip() for line in lines if line.strip()]


def _damaged(rows: list[bytes]) -> str:
    return "A row is damaged" if len(rows) == 1 else f"{len(rows)} rows are damaged"
