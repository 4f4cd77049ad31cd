"""Whose a reproduction's folder is: a table's, so that no card counts another table's trainings as its own."""

from __future__ import annotations

import contextlib
import json
import os
import re
from collections.abc import Iterator
from pathlib import Path

from understudy.errors import RunError
from understudy.folders import check_within, read, write_atomically
from understudy_report.values import mapping

_MARK = "reproduction.json"
#: What sweeps leave, there before this file was: of a grid, and of a search in ``ROW/COLUMN/seedN``.
_SWEEPS = ("sweep.json", "journal.jsonl", "*/*/seed*/journal.jsonl")
#: What a card would overwrite or be mixed with in a folder that is nobody's.
_OTHERS = ("card.*", "curves.csv", "*.html", "*.mp4", "[!.]*/*")


@contextlib.contextmanager
def belongs_to(table: str, folder: Path) -> Iterator[None]:
    """Inside, the `table` is trained and shown in `folder`, which from then on is its own.

    Raises
    ------
    RunError
        the folder is a run's, another table's or somebody else's, a part of it leads out of it, or it is no folder.
    """
    try:
        _refuse(table, folder)
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise RunError(f"The folder {folder} cannot be used: {error.strerror}.") from error
    write_atomically(folder / _MARK, json.dumps({"table": table}).encode())
    try:
        yield
    finally:
        if os.listdir(folder) == [_MARK]:  # nothing was begun
            (folder / _MARK).unlink()
            folder.rmdir()


def _refuse(table: str, folder: Path) -> None:
    elsewhere = "Give run.dir another folder."
    if os.path.lexists(folder) and not folder.is_dir():
        raise RunError(f"{folder} is no folder. {elsewhere}")
    place = Path(os.path.realpath(folder))
    for outer in (
        above for above in (place, *place.parents) if os.path.lexists(above / "run.json")
    ):
        where = "is" if outer == place else "is inside"
        raise RunError(f"{folder} {where} the run {outer}. {elsewhere}")
    owner = _owner(folder)
    if owner not in (None, table):
        raise RunError(f"{folder} holds another table, {owner}. {elsewhere}")
    if owner is None and not any(file for name in _SWEEPS for file in folder.glob(name)):
        for left in (file for name in _OTHERS for file in folder.glob(name)):
            raise RunError(
                f"{folder} is not new: it holds {left.relative_to(folder)}, and no table. Give run.dir a folder that "
                "is new or empty."
            )
    if folder.exists():
        check_within(folder)


def _owner(folder: Path) -> str | None:
    """The table whose folder it is; where none has said so yet, the one whose card lies there."""
    with contextlib.suppress(OSError, ValueError, LookupError, RecursionError):
        return str(mapping(json.loads(read(folder / _MARK)))["table"])
    with contextlib.suppress(OSError):
        text = read(folder / "card.md").decode(errors="replace")
        named = re.findall(r"^`understudy reproduce (\S+)`, understudy \S+$", text, re.MULTILINE)
        return named[-1] if named else None
    return None
