"""This product's own formats: a table of named columns (CSV), and everything a clip has (NPZ).

SI units, z up, x forward, quaternions wxyz: nothing is converted.

**NPZ** holds ``format`` = "understudy.clip", ``version`` = 1, ``name``, ``loop``, the texts of
:data:`PROVENANCE`, ``joint_names`` (J,), ``times`` (F,) s, ``root_position`` (F, 3) m and
``rotations`` (F, J, 4); with a skeleton also ``parents`` (J,), ``offsets`` (J, 3) m, ``tip_joints``
(K,) and ``tips`` (K, 3) m. A clip comes back as it was written.

**CSV** has one row per frame under a row of column names, in any order: ``time`` (s); ``root.px``,
``root.py``, ``root.pz`` (m); and for each joint, the root first, ``NAME.qw``, ``.qx``, ``.qy``,
``.qz`` or its rotation vector ``NAME.rx``, ``.ry``, ``.rz`` (rad). Lines before it that begin with
``#`` may say ``# rate: 60`` (frames/s, instead of ``time``), ``# loop: true`` and
``# licence: TEXT``; others are remarks, as anywhere in it, and so are those of ``%``, ``//`` and ``;``. It has no skeleton. Semicolons, tabs, bars or blanks may
stand between the columns, decimal commas in numbers; columns without a name, and those of row numbers, are left out.
A column's name, or a row of units below the names, may say another unit, ``root.px [cm]``, ``knee.rx [deg]``,
``time [ms]``; times a second or more apart need that. Times begin at the first frame's, and may be dates and times of ISO 8601, a clock's, or counts of
milli-, micro- or nanoseconds since 1970.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.limits import check_size, checked_skeleton, read_bytes
from understudy_motion.origin import MAX_RECORD_LINE, provenance
from understudy_motion.readers.columns import (
    names_joints,
    plain_name,
    plain_names,
    rate_of,
    said_of,
    scale_of,
    units_in,
)
from understudy_motion.readers.frames import check_sizes
from understudy_motion.readers.npz import ZIP_MAGIC, Archive, array_names
from understudy_motion.readers.text import decoded, number_rows, shown, with_row_names
from understudy_motion.readers.times import is_plain_time, since_first
from understudy_motion.reading import SLOWEST_RATE, UNSAID, ClipReader, ReadOptions, metres_of
from understudy_tensors import rotations

FORMAT = "understudy.clip"
VERSION = 1
PROVENANCE = ("source", "licence", "sha256", "url", "attribution")
"""Texts of the NPZ, and fields of a clip, that say where its motion comes from."""

QUATERNION = ("qw", "qx", "qy", "qz")
VECTOR = ("rx", "ry", "rz")
ROOT_POSITION = ("root.px", "root.py", "root.pz")
UNREAD = re.compile(
    r"(index|idx|id|n|no\.?|nr\.?|sample|step|level_[0-9]+|unnamed: [0-9.]+"
    r"|(?:frames?|row)(?:[_ ]?(?:index|idx|id|number|no\.?|nr\.?|num|#))?|)",
    re.IGNORECASE,
)
"""Columns of row numbers, and empty ones, as spreadsheets and pandas write them."""
DELIMITERS = ",;\t|"
REMARKS = ("#", "%", "//")
_FEWEST = 6
"""Columns of a table: the root's position and its rotation vector."""


class NpzReader(ClipReader):
    """Reads this product's NPZ."""

    fixed = MappingProxyType(
        {"unit": "m", "up": "z", "rate": None, "skeleton": None, "angles": None}
    )
    suffixes = (".npz",)

    def recognises(self, head: bytes, path: Path) -> bool:
        return head.startswith(ZIP_MAGIC) and {"format", "version"} <= array_names(path)

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        archive = Archive(path)
        if archive.text("format") != FORMAT or archive.number("version") != VERSION:
            raise FileError(
                f"Clip {path}: not of format '{FORMAT}' version {VERSION}; convert it with the "
                "version that wrote it."
            )
        times = archive.floats("times", None)
        joint_names = archive.texts("joint_names")
        num_frames, num_joints = len(times), len(joint_names)
        check_size(path, num_frames, joint_names)
        clip = Clip(
            name=archive.text("name"),
            times=torch.from_numpy(times),
            root_position=torch.from_numpy(archive.floats("root_position", num_frames, 3)),
            rotations=torch.from_numpy(archive.floats("rotations", num_frames, num_joints, 4)),
            joint_names=joint_names,
            loop=archive.flag("loop") if options.loop is None else options.loop,
            skeleton=_skeleton(path, archive, joint_names),
            source=str(path),  # for messages, until the clip is known to be one
        )
        return replace(clip, **{field: archive.text(field) for field in PROVENANCE})


def _skeleton(path: Path, archive: Archive, joint_names: tuple[str, ...]) -> Skeleton | None:
    if "parents" not in archive.names:
        return None
    joints = len(joint_names)
    tip_joints = archive.texts("tip_joints")
    tips = archive.floats("tips", len(tip_joints), 3)
    return checked_skeleton(
        path,
        joint_names,
        archive.integers("parents", joints).tolist(),
        archive.floats("offsets", joints, 3),
        dict(zip(tip_joints, tips, strict=True)),
    )


class CsvReader(ClipReader):
    """Reads a table of named columns."""

    fixed = MappingProxyType({"up": "z", "skeleton": None, "angles": None})
    suffixes = (".csv",)

    def recognises(self, head: bytes, path: Path) -> bool:
        lines = decoded(head).splitlines()
        _, start = _comments(lines)
        if start == len(lines):
            return False
        header, _, delimiter = _parted(lines[start:])
        columns = _cells(header, delimiter)
        return ROOT_POSITION[0] in columns or names_joints(columns)

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path)
        lines = decoded(content).splitlines()
        said, start = _comments(lines)
        header, body, delimiter = _parted(lines[start:])
        header = with_row_names(header, body, delimiter)
        names, columns = _raw(header, delimiter), _cells(header, delimiter)
        body = [_row(line, len(columns), delimiter) for line in body]
        names = _with_units(names, body, delimiter)
        columns, body = _plain(path, columns, body, delimiter)
        if "time" not in columns and (gap := _gap(lines[start + 1 :], body, delimiter)) is not None:
            raise FileError(
                f"Clip {path}: line {start + 2 + gap}: a frame without numbers, and no column 'time' says how long "
                "it takes; fill it in, or add the times."
            )
        scales = dict(zip(plain_names(names), map(scale_of, names), strict=True))
        joints = _joint_columns(path, columns)
        num_frames = sum(1 for line in body if line.strip())
        check_size(path, num_frames, tuple(joints))
        if "time" in columns:
            body = _timed(path, body, columns, delimiter, scales["time"])
        rows = number_rows(path, body, start + 2, len(columns), delimiter)
        rows = rows * [scales[name] for name in columns]
        places = rows[:, [columns.index(c) for c in ROOT_POSITION]]
        if options.unit:
            places = places * metres_of(options.unit)
        turns = [rows[:, at] for at in joints.values()]
        stated = any(line.startswith("# units:") for line in lines[:start])  # as the writer does
        vectors = [values for values in turns if values.shape[1] == 3]
        check_sizes(
            path,
            np.stack(vectors, axis=1) if vectors else np.zeros((len(rows), 1, 3)),
            None if options.unit or stated else places[:, 2],
        )
        fields = provenance(path, content)
        if "licence" in said:
            fields["licence"] = said["licence"][:MAX_RECORD_LINE]
        return Clip(
            name=path.stem,
            times=_times(path, rows, columns, said, options, stated or _says_unit(names)),
            root_position=torch.from_numpy(places),
            rotations=torch.stack([_rotation(values) for values in turns], dim=1),
            joint_names=tuple(joints),
            loop=_loop(path, said) if options.loop is None else options.loop,
            **fields,
        )


def _comments(lines: Sequence[str]) -> tuple[dict[str, str], int]:
    """What the comments before the table say, and the index of the line of column names."""
    said: dict[str, str] = {}
    for index, line in enumerate(lines):
        if comment := said_of(line):
            said[comment[0]] = comment[1]
        elif (
            line.strip()
            and not line.lower().lstrip('"').startswith("sep=")
            and (not _is_remark(line, ";", _FEWEST) or ROOT_POSITION[0] in line)
        ):
            return said, index
    return said, len(lines)


def _is_remark(line: str, delimiter: str, columns: int) -> bool:
    """Whether a `line` is a remark in a table of so many `columns`. A semicolon begins one where it does not part
    columns, and where it does if words follow that are too few for a row, whose first cell may be empty."""
    plain = line.lstrip(' "')
    if not plain.startswith(";"):
        return plain.startswith(REMARKS)
    few = plain.count(";") < columns - 1 and re.search(r"[^\W\d_]{2}", plain)
    return delimiter != ";" or bool(few)


def _parted(lines: Sequence[str]) -> tuple[str, Sequence[str], str]:
    """Of a table's `lines`: that of the names, the others, and what stands between columns, where that is blanks
    changed to commas."""
    header = lines[0] if lines else ""
    if delimiter := _delimiter(header):
        return header, lines[1:], delimiter
    return _by_commas(header.lstrip("# ")), [_by_commas(line) for line in lines[1:]], ","


def _by_commas(line: str) -> str:
    """`line` with commas for the blanks between its words, none of which is before a unit."""
    apart = re.sub(r"\s+(?=[\[(])", "", line.strip().replace(",", "."))
    return re.sub(r"\s+", ",", apart)


def _with_units(names: Sequence[str], body: list[str], delimiter: str) -> list[str]:
    """`names` with the units that the first row of `body` has for them, which is emptied then."""
    at = next((i for i, line in enumerate(body) if line), None)
    units = None if at is None else units_in(body[at].split(delimiter))
    if at is None or units is None or len(units) != len(names):
        return list(names)
    body[at] = ""
    return [
        f"{name} [{unit}]" if unit and plain_name(f"{name} [{unit}]") == plain_name(name) else name
        for name, unit in zip(names, units, strict=True)
    ]


def _gap(raw: Sequence[str], body: Sequence[str], delimiter: str) -> int | None:
    """The first row that has delimiters and no cells, between others that have some."""
    full = [i for i, line in enumerate(body) if line.strip()]
    between = range(full[0], full[-1]) if full else ()
    return next(
        (
            i
            for i in between
            if not body[i].strip()
            and raw[i].strip(' "')[:1] in tuple(DELIMITERS)
            and not _is_remark(raw[i], delimiter, _FEWEST)
        ),
        None,
    )


def _timed(
    path: Path, body: Sequence[str], columns: Sequence[str], delimiter: str, unit: float
) -> Sequence[str]:
    """`body` with numbers in its column of times, which are in a `unit` of so many s."""
    at = columns.index("time")
    rows = {i: cells for i, line in enumerate(body) if len(cells := line.split(delimiter)) > at}
    words = [cells[at].strip() for cells in rows.values()]
    if not words or not words[0] or is_plain_time(words[0]):
        return body
    lines = list(body)
    try:
        times = since_first(words, unit)
    except ValueError as error:
        raise FileError(f"Clip {path}: column 'time': {error}.") from error
    for (i, cells), time in zip(rows.items(), times, strict=True):
        cells[at] = repr(time)
        lines[i] = delimiter.join(cells)
    return lines


def _delimiter(header: str) -> str:
    """What stands between the column names, which may have others in them; none if nothing does."""
    found = [d for d in DELIMITERS if d in header]
    parting = [d for d in found if ROOT_POSITION[0] in _cells(header, d)]
    return max(parting or found, key=header.count, default="")


def _cells(header: str, delimiter: str) -> list[str]:
    return plain_names(_raw(header, delimiter))


def _raw(header: str, delimiter: str) -> list[str]:
    names = [name.strip().strip('"').strip() for name in header.split(delimiter)]
    names = [n[1:-1] if len(n) > 2 and n[0] == n[-1] == "'" else n for n in names]
    names[0] = names[0].lstrip("# ")
    return names


def _row(line: str, count: int, delimiter: str) -> str:
    """`line` of a table of `count` columns, empty where it is a comment or delimiters alone, and without one at its
    end that no column's name has."""
    if _is_remark(line, delimiter, count) or not line.strip(f"{delimiter} "):
        return ""
    more = line.count(delimiter) == count and line.rstrip(" ").endswith(delimiter)
    return line.rstrip(" ")[:-1] if more else line


def _plain(
    path: Path, columns: Sequence[str], body: Sequence[str], delimiter: str
) -> tuple[list[str], Sequence[str]]:
    """Column names and lines without :data:`UNREAD` columns, quotes and decimal commas."""
    kept = [i for i, name in enumerate(columns) if not UNREAD.fullmatch(name)]
    commas = delimiter != "," and any("," in line for line in body)
    if len(kept) == len(columns) and not commas and not any('"' in line for line in body):
        return list(columns), body
    lines = []
    try:
        for row in csv.reader(body, delimiter=delimiter):
            cells = [cell.strip().replace(",", ".") for cell in row]
            whole = len(cells) == len(columns)
            lines.append(delimiter.join([cells[i] for i in kept] if whole else cells))
    except csv.Error as error:
        raise FileError(f"Clip {path}: its table cannot be read: {error}.") from error
    return [columns[i] for i in kept], lines


def _joint_columns(path: Path, columns: Sequence[str]) -> dict[str, list[int]]:
    """By joint, in order of appearance: the columns of its quaternion or rotation vector."""
    index = {name: column for column, name in enumerate(columns)}
    if len(index) != len(columns):
        twice = next(name for name in columns if columns.count(name) > 1)
        raise FileError(
            f"Clip {path}: column {shown(twice)} is there twice. Remove one, or rename it."
        )
    for name in ROOT_POSITION:
        if name not in index:
            raise FileError(
                f"Clip {path}: column '{name}' is missing; the root's position is in {', '.join(ROOT_POSITION)}, in m. "
                "Rename its columns so, or add them."
            )
    parts: dict[str, set[str]] = {}
    for name in columns:
        joint, _, part = name.rpartition(".")
        if joint and part in (*QUATERNION, *VECTOR):
            parts.setdefault(joint, set()).add(part)
        elif name != "time" and name not in ROOT_POSITION:
            raise FileError(
                f"Clip {path}: column {shown(name)} is not known; a joint's are NAME.qw, .qx, .qy, .qz "
                "or NAME.rx, .ry, .rz. Rename it so, or remove it."
            )
    joints: dict[str, list[int]] = {}
    for joint, found in parts.items():
        whole = next((form for form in (QUATERNION, VECTOR) if found == set(form)), None)
        if whole is None:
            raise FileError(
                f"Clip {path}: joint {shown(joint)} needs either {', '.join(QUATERNION)} or "
                f"{', '.join(VECTOR)}, and has {', '.join(sorted(found))}. Add what it lacks, or remove its columns."
            )
        joints[joint] = [index[f"{joint}.{part}"] for part in whole]
    if not joints:
        raise FileError(f"Clip {path}: no column has the root's rotation (root.qw, …).")
    return joints


def _times(
    path: Path,
    rows: np.ndarray,
    columns: Sequence[str],
    said: dict[str, str],
    options: ReadOptions,
    seconds: bool,
) -> torch.Tensor:
    """(F,) s, of the first 0; `seconds` says whether the file has its unit of times."""
    rate = options.rate
    if "time" in columns and rate is None:
        times = rows[:, columns.index("time")]
        usual = float(np.median(np.diff(times))) if len(times) > 2 else 0.0
        if not seconds and usual * SLOWEST_RATE >= 1.0:
            raise FileError(
                f"Clip {path}: its times are {usual:.4g} s apart. If they are no seconds, say what they are, as 'time [ms]' "
                "or 'frame' in their column's name, the latter with '# rate: 30' above; if they are, 'time [s]'."
            )
        return torch.from_numpy(times - times[:1])
    if rate is None:
        if "rate" not in said:
            raise FileError(
                f"Clip {path}: there is neither a column 'time' nor a line '# rate: 60'; give "
                "motion.rate (--source-rate)."
            )
        rate = rate_of(path, said["rate"])
    return torch.arange(len(rows), dtype=torch.float64) / rate


def _says_unit(names: Sequence[str]) -> bool:
    """Whether the column of times, among these `names`, says its unit."""
    return any(
        plain_name(name) == "time" and re.search(r"[\[(_/ ]|seconds", name) for name in names
    )


def _loop(path: Path, said: dict[str, str]) -> bool:
    word = said.get("loop", "false").lower()
    if word not in ("true", "false"):
        raise FileError(f"Clip {path}: '# loop:' is true or false, not {shown(word)}.")
    return word == "true"


def _rotation(values: np.ndarray) -> torch.Tensor:
    """(F, 4) of a joint's columns."""
    rotation = torch.from_numpy(values)
    return rotation if values.shape[1] == 4 else rotations.from_exponential_map(rotation)
