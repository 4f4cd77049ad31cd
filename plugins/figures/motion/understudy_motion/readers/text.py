"""Text files: their encodings and comments; numbers, read fast, and where one is wrong, found and named."""

from __future__ import annotations

import codecs
import re
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from understudy.errors import FileError

LARGEST = 1e12
"""Beyond it a number in a motion file is taken for damage: no angle, length or time is so large."""

GAPS = frozenset(
    (
        "",
        "-",
        "?",
        "nan",
        "-nan",
        "+nan",
        "inf",
        "-inf",
        "+inf",
        "na",
        "n/a",
        "#n/a",
        "null",
        "none",
    )
)
"""What stands in a table where a number was not measured, in small letters."""

_MARKS = (
    (codecs.BOM_UTF8, "utf-8-sig"),
    (codecs.BOM_UTF32_LE, "utf-32"),
    (codecs.BOM_UTF32_BE, "utf-32"),
    (codecs.BOM_UTF16_LE, "utf-16"),
    (codecs.BOM_UTF16_BE, "utf-16"),
)


def decoded(content: bytes) -> str:
    """The text of a file, or of its beginning: UTF-8; UTF-16 or 32 with a byte-order mark, or UTF-16
    as the zeros in it show; else Windows' western code page."""
    marked = next((encoding for mark, encoding in _MARKS if content.startswith(mark)), None)
    if marked is None and content[1:2] == b"\0":
        marked = "utf-16-le"
    elif marked is None and content[:1] == b"\0":
        marked = "utf-16-be"
    try:
        text = content.decode(marked or "utf-8", errors="replace" if marked else "strict")
    except UnicodeDecodeError:
        text = content.decode("cp1252", errors="replace")
    text = text.replace("\u2212", "-")  # the minus of typographers
    text = re.sub("[\ufeff\u200b]", "", text)  # a second mark, as where files were put together
    return text.rstrip("\0\x1a")  # with which old programs end a file


def without_comments(lines: Sequence[str]) -> list[str]:
    """The lines without blanks around them, empty where they begin with ``#``, ``//`` or ``;``."""
    stripped = (line.strip() for line in lines)
    return ["" if line.startswith(("#", "//", ";")) else line for line in stripped]


def with_row_names(header: str, body: Sequence[str], delimiter: str | None) -> str:
    """`header`, the names of a table's columns, with one for the rows' names, ``1``, ``2``, …, if these stand to the
    left of every row of `body` and it has none for them, as R writes it."""
    count = len(header.split(delimiter)) + 1
    rows = (line.split(delimiter) for line in body if line.strip())
    for n, cells in enumerate(rows, start=1):
        if len(cells) != count or not cells[-1].strip() or cells[0].strip(' "') != str(n):
            return header
    return f"row{delimiter or ' '}{header}" if any(line.strip() for line in body) else header


def is_number(word: str) -> bool:
    """Whether `word` is a number up to :data:`LARGEST`, in ASCII and without underscores."""
    try:
        return word.isascii() and "_" not in word and abs(float(word)) <= LARGEST
    except ValueError:
        return False


def shown(text: str) -> str:
    """`text` quoted and cut, for a message."""
    return repr(text if len(text) <= 40 else text[:40] + "…")


def number_rows(
    path: Path, lines: Sequence[str], first: int, columns: int, delimiter: str | None = None
) -> np.ndarray:
    """The (F, `columns`) numbers of `lines`, of which the first is the file's line `first`.

    Blank lines are skipped. `delimiter` None is any white space.

    Raises
    ------
    FileError
        naming the line that has another count, or something that is no :func:`is_number`.
    """
    if not any(line.strip() for line in lines):
        return np.empty((0, columns))
    try:
        rows = np.loadtxt(lines, delimiter=delimiter, comments=None, ndmin=2)
    except (ValueError, OverflowError):
        rows = None
    if rows is not None and rows.shape[1] == columns and (np.abs(rows) <= LARGEST).all():
        return rows
    for number, line in enumerate(lines, start=first):
        words = line.split(delimiter)
        if not line.strip():
            continue
        if len(words) != columns:
            raise FileError(
                f"Clip {path}: line {number}: {columns} numbers are needed, not {len(words)}; correct it."
            )
        for at, word in enumerate(words):
            if not is_number(word):
                mend = _mended(lines, at, delimiter) if _is_gap(word) else "correct it"
                raise FileError(
                    f"Clip {path}: line {number}: {shown(word)} is not a number; {mend}."
                )
    raise FileError(f"Clip {path}: from line {first} on, its numbers cannot be read.")


def _is_gap(word: str) -> bool:
    return word.strip(' "').lower() in GAPS


def _mended(lines: Sequence[str], column: int, delimiter: str | None) -> str:
    """What to do about a gap in a `column` of a table."""
    rows = (line.split(delimiter) for line in lines if line.strip())
    if all(_is_gap(cells[column]) for cells in rows if len(cells) > column):
        return "its column has none: fill it in, or remove it"
    return "fill it in from the frames around it"
