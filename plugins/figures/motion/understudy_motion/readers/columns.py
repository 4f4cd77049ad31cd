"""Tables: what remarks before them, names of columns and rows of units say."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence
from pathlib import Path

from understudy.errors import FileError
from understudy_motion.readers.text import is_number, shown
from understudy_motion.reading import no_rate

_SAID = re.compile(
    r'\s*"?(?:#|%|//|;)\s*(?:(rate|frame[ _]?rate|fps)|(loop)|(licen[cs]e))\s*[:=](.*)',
    re.IGNORECASE,
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
    if why := no_rate(float(number)):
        raise FileError(f"Clip {path}: the rate {shown(word)} is none: {why}.")
    return float(number)


_COLUMN = re.compile(
    r"(?:(root)[._/ :-](?:(?:p|t|pos(?:ition)?|trans(?:lat(?:e|ion))?)[._ ]?)?([xyz])|(.*)\.(q[wxyz]|r[xyz])"
    r"|(?!root|base|pelvis)(.+)[_/ :-](?:q|quat[._ ]?)([wxyz]))"
    r"(?:(?:\s*[\[(]\s*|_)(m|cm|mm|in|inch|inches|ft|foot|feet|rad|deg|degrees?|°)?\s*[\])]?)?",
    re.IGNORECASE,
)

_QUATERNION = re.compile(
    r"(.+?)[._/ :-]+(?:q|quat(?:ernion)?|rot(?:ation)?|ori(?:entation)?)?[._ ]?([wxyz])",
    re.IGNORECASE,
)
"""Joint and part of a quaternion, where there are columns of all four parts."""
_ROOTS = ("root", "base", "pelvis")

_TIME = re.compile(
    r"(?:time|times|t|timestamp|seconds|secs?|elapsed(?:[_ ]time)?)"
    r"(?:[_ /]*[\[(]?(s|sec|seconds|ms|milliseconds|us|µs|microseconds|ns|nanoseconds)[\])]?)?",
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
    "in": 0.0254,
    "f": 0.3048,
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
        "inch": "in inch inches",
        "ft": "ft foot feet",
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


def plain_names(columns: Sequence[str]) -> list[str]:
    """:func:`plain_name` of the columns of a table of joints, in which four that end with w, x, y and z are a
    quaternion, of the root, too."""
    names = [plain_name(column) for column in columns]
    for joint, parts in _quaternions(columns).items():
        for part, at in parts.items():
            names[at] = f"{joint}.q{part}"
    return names


def _quaternions(columns: Sequence[str]) -> dict[str, dict[str, int]]:
    """By joint and part: the columns of quaternions that are whole, and not written as here."""
    found: dict[str, dict[str, int]] = {}
    for at, column in enumerate(columns):
        if (named := _QUATERNION.fullmatch(column)) and not column.endswith(f".q{named[2]}"):
            found.setdefault(named[1], {}).setdefault(named[2].lower(), at)
    return {joint: parts for joint, parts in found.items() if len(parts) == 4}


def names_joints(columns: Iterable[str]) -> bool:
    """Whether `columns` have rotations of a joint beside the root, NAME.qw or NAME.rx, as no robot's table has."""
    columns = list(columns)
    if len(_quaternions(columns)) > 1:
        return True
    found = (_COLUMN.fullmatch(column) for column in columns)
    return any(f and (f[5] or (f[3] and f[3].lower() not in _ROOTS)) for f in found)


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
