"""Text files: their encodings and comments; numbers, read fast, and where one is wrong, found and named."""

from __future__ import annotations

import codecs
import math
import re
from collections.abc import Iterable, Sequence
from datetime import datetime, timedelta
from pathlib import Path

import numpy as np

from understudy.errors import FileError

LARGEST = 1e12
"""Beyond it a number in a motion file is taken for damage: no angle, length or time is so large."""


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


def is_number(word: str) -> bool:
    """Whether `word` is a number up to :data:`LARGEST`, in ASCII and without underscores."""
    try:
        return word.isascii() and "_" not in word and abs(float(word)) <= LARGEST
    except ValueError:
        return False


def shown(text: str) -> str:
    """`text` quoted and cut, for a message."""
    return repr(text if len(text) <= 40 else text[:40] + "…")


_SAID = re.compile(
    r'\s*"?(?:#|%|//)\s*(?:(rate|frame[ _]?rate|fps)|(loop)|(licen[cs]e))\s*[:=](.*)', re.IGNORECASE
)
"""A line before a table that says something of it; spreadsheets quote it, or end it with delimiters."""


def said_of(line: str) -> tuple[str, str] | None:
    """What a remark before a table says of it, None if nothing: "rate", "loop" or "licence", and its value."""
    if not (found := _SAID.match(line)):
        return None
    name = "rate" if found[1] else "loop" if found[2] else "licence"
    return name, found[4].strip(',;\t| "')


def rate_of(path: Path, word: str) -> float:
    """Frames per second, of what :func:`said_of` gives of a rate."""
    number = re.sub(r"\s*(hz|fps)$", "", word, flags=re.IGNORECASE).replace(",", ".")
    if not is_number(number) or not 0.0 < float(number) <= 1e6:
        raise FileError(f"Clip {path}: the rate {shown(word)} is no number of frames per second.")
    return float(number)


_COLUMN = re.compile(
    r"(?:(root)[._/ -](?:p|t|pos[._]?|position[._]?|trans[._]?)?([xyz])|(.*)\.(q[wxyz]|r[xyz])"
    r"|(?!root|base|pelvis)(.+)[_/ :-](?:q|quat[._ ]?)([wxyz]))"
    r"(?:\s*[\[(]\s*(m|cm|mm|rad|deg|degrees?|°)?\s*[\])])?",
    re.IGNORECASE,
)
_TIME = re.compile(
    r"(?:time|times|t|timestamp|seconds)"
    r"(?:[_ ]*[\[(]?(s|sec|seconds|ms|milliseconds|us|µs|microseconds|ns|nanoseconds)[\])]?)?",
    re.IGNORECASE,
)
_SCALES = {
    "c": 0.01,
    "mm": 0.001,
    "d": math.pi / 180.0,
    "°": math.pi / 180.0,
    "ms": 0.001,
    "mil": 0.001,
    "us": 1e-6,
    "µs": 1e-6,
    "mic": 1e-6,
    "n": 1e-9,
}
"""m, rad or s in a unit that begins so."""
_UNITS = {
    word: unit
    for unit, words in {
        "m": "m metre metres meter meters",
        "cm": "cm centimetre centimetres centimeter centimeters",
        "mm": "mm millimetre millimetres millimeter millimeters",
        "rad": "rad radian radians",
        "deg": "deg degree degrees °",
        "s": "s sec secs second seconds",
        "ms": "ms msec millisecond milliseconds",
        "us": "us µs microsecond microseconds",
        "ns": "ns nanosecond nanoseconds",
        "": "- – 1 # none unitless quat quaternion n/a na",
    }.items()
    for word in ("", *words.split())
}
"""By what stands in a row of units below a table's names: the unit, empty where there is none."""


def plain_name(column: str) -> str:
    """The name of a table's `column` as it is written here: without a unit, its part in small letters."""
    if _TIME.fullmatch(column):
        return "time"
    if found := _COLUMN.fullmatch(column):
        root, position, joint, rotation, other, part = found.groups()[:6]
        if root:
            return f"root.p{position.lower()}"
        return f"{other}.q{part.lower()}" if other else f"{joint}.{rotation.lower()}"
    return column


def names_joints(columns: Iterable[str]) -> bool:
    """Whether `columns` have rotations of a joint beside the root, NAME.qw or NAME.rx, as no robot's table has."""
    found = (_COLUMN.fullmatch(column) for column in columns)
    return any(
        f and (f[5] or (f[3] and f[3].lower() not in ("root", "base", "pelvis"))) for f in found
    )


def scale_of(column: str) -> float:
    """m, rad or s in the unit that the name of a table's `column` says, 1 if none."""
    found = _TIME.fullmatch(column) or _COLUMN.fullmatch(column)
    return scale_of_unit((found[found.re.groups] or "").lower() if found else "")


def scale_of_unit(unit: str) -> float:
    """m, rad or s in a `unit`, 1 if it is one of these, or none."""
    return next((scale for start, scale in _SCALES.items() if unit.startswith(start)), 1.0)


def units_in(cells: Sequence[str]) -> list[str] | None:
    """The units that the `cells` of a row name, as they are called here, None if it is no row of units."""
    words = [cell.strip(' []()"').lower() for cell in cells]
    if not all(word in _UNITS for word in words) or not any(_UNITS[word] for word in words):
        return None
    return [_UNITS[word] for word in words]


_CLOCK = re.compile(
    r"(?:(\d+) days?,? )?(?:(\d+):)?(\d+):(\d\d?(?:[.,]\d+)?)",
)
"""Days, hours, minutes and seconds."""
_COUNTED = 10**11
"""A time beyond it is no number of seconds, but a computer's count of parts of them since 1970."""


def is_plain_time(word: str) -> bool:
    """Whether `word` is a number that is a time as it is."""
    return is_number(word) and abs(float(word)) < _COUNTED


def since_first(words: Sequence[str], unit: float = 1.0) -> list[float]:
    """The times of a column, since the first of them, in a `unit` of so many s: of dates and clocks (ISO 8601,
    ``10:00:01.5``), and of counts since 1970, which are of milli-, micro- or nanoseconds by their size if the unit
    is the second.

    Raises
    ------
    ValueError
        one of them is none, or of another kind than the first; it says which, and what to write.
    """
    counts = bool(words) and words[0].isdecimal()
    times = list[int]()
    for word in words:
        time = _count(word) if counts else _microseconds(word)
        if time is None:
            raise ValueError(
                f"{shown(word)} is no time; write seconds, as 0.033, or a date and time of ISO 8601"
            )
        times.append(time)
    per = 1e6 * unit
    if counts:
        size = times[0]
        by_size = 1e3 if size < 10**14 else 1e6 if size < 10**17 else 1e9
        per = by_size if unit == 1.0 else 1.0
    return [(time - times[0]) / per for time in times]


def _count(word: str) -> int | None:
    return int(word) if word.isascii() and word.isdecimal() and len(word) < 25 else None


def _microseconds(word: str) -> int | None:
    """That a date, or a clock, says."""
    if clock := _CLOCK.fullmatch(word):
        days, hours, minutes = (int(part or 0) for part in clock.groups()[:3])
        seconds = float(clock[4].replace(",", "."))
        return 60_000_000 * (60 * (24 * days + hours) + minutes) + round(1e6 * seconds)
    try:
        date = datetime.fromisoformat(word)
    except ValueError:
        return None
    return (date - datetime(2000, 1, 1, tzinfo=date.tzinfo)) // timedelta(microseconds=1)


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
                f"Clip {path}: line {number}: {columns} numbers are needed, not {len(words)}."
            )
        for word in words:
            if not is_number(word):
                raise FileError(f"Clip {path}: line {number}: {shown(word)} is not a number.")
    raise FileError(f"Clip {path}: from line {first} on, its numbers cannot be read.")
