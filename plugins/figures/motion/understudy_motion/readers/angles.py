"""Robots' own motion tables: the root's pose and the angles of a robot's hinges, one row a frame.

Two are read. *Without a header*, as mjlab, BeyondMimic and Unitree's retargeted LAFAN1 have it: the
root's position (m), its quaternion (xyzw; or, as MuJoCo's ``qpos``, wxyz, if only so the root is
upright), then the angles (rad) in the order of the robot's model; commas, semicolons or blanks stand
between; a row of names may stand above, in a remark too, and a column of times (s) or of frames' numbers before. Names
of all seven root's columns say their order, and names may end with a unit (``knee [deg]``, ``time_ms``). *ProtoMotions'*: columns ``Frame``, ``root_translateX`` … (cm), ``root_rotateX`` … (degrees,
extrinsic about x, y, z), ``NAME_dof`` (degrees). z is up. Frames come 30 a second unless told otherwise,
which is what those programs take them to do.

What an angle means only the robot's model says. So the clip has a joint ``angle NAME``, or
``angle 1`` …, for each, turned about x by it, and becomes the robot's where a robot is at hand.
"""

from __future__ import annotations

import contextlib
import csv
import itertools
import re
from collections.abc import Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch
from scipy.spatial.transform import Rotation

from understudy.errors import FileError
from understudy_motion.clip import ANGLE, Clip
from understudy_motion.limits import check_size, read_bytes
from understudy_motion.origin import provenance
from understudy_motion.readers.columns import (
    names_joints,
    plain_name,
    rate_of,
    said_of,
    scale_of,
    scale_of_unit,
    units_in,
)
from understudy_motion.readers.table import REMARKS, UNREAD
from understudy_motion.readers.text import (
    decoded,
    is_number,
    number_rows,
    with_row_names,
    without_comments,
)
from understudy_motion.readers.times import is_plain_time, since_first
from understudy_motion.reading import (
    HEAD_BYTES,
    UNSAID,
    AngleUnit,
    ClipReader,
    ReadOptions,
    metres_of,
)
from understudy_tensors import rotations

__all__ = ["RATE"]

RATE = 30.0
_PROTOMOTIONS = ["frame", *(f"root_{what}{axis}" for what in ("translate", "rotate") for axis in "xyz")]  # fmt: skip
_COUNTED = re.compile(r"([a-z_ :.]{0,20}?)([0-9]{1,4})(?:\.0)?", re.IGNORECASE)
"""The number of a column, perhaps with a word before it."""
_TURN, _FAR = 2.0 * np.pi, 50.0
"""rad and m beyond which the unit is another."""
_ROOT = re.compile(
    r"(?:(?:floating[\W_]*)?(?:root|base|pelvis|free(?:joint)?|global))?[\W_]*"
    r"(?:(?:pos(?:ition)?|trans(?:lation)?|p|t)?[\W_]*([xyz])|(?:q|quat(?:ernion)?|rot(?:ation)?|ori(?:entation)?)[\W_]*([wxyz]))",
    re.IGNORECASE,
)
"""Names of the root's columns."""
_UNIT = re.compile(r"(.*?)\s*(?:[\[(]\s*([\w°]*)\s*[\])]|_(deg|rad|cm|mm))", re.IGNORECASE)
"""A name with a unit."""
_UPRIGHT = 0.5
"""Least z of a root's own up, on average, to be called upright."""


class AnglesReader(ClipReader):
    """Reads robots' tables of angles."""

    fixed = MappingProxyType({"up": "z", "skeleton": None})
    suffixes = (".csv", ".txt")

    def recognises(self, head: bytes, path: Path) -> bool:
        lines = decoded(head).splitlines()
        raw = _laid_out(lines[:-1] if len(head) == HEAD_BYTES else lines)  # the last may be cut
        lines = [line for line in without_comments(raw) if line]
        if not lines or _named_in_remark(raw):
            return False
        words = _words(lines[0], _delimiter(lines[0]))
        if [word.lower() for word in words[:7]] == _PROTOMOTIONS:
            return True
        plain = [plain_name(word) for word in words]
        whole = "root.px" in plain and any(word.endswith(".qw") for word in plain)
        if whole or names_joints(words):  # of named joints' rotations: has its own reader
            return False
        order = None
        if _names(lines) or (len(lines) > 1 and _counts(words)):
            order = _root_columns(words)
            words = _words(lines[1], _delimiter(lines[0]))
            if units_in(words) and len(lines) > 2:  # blanks at its ends do not matter here
                words = _words(lines[2], _delimiter(lines[0]))
        if not is_plain_time(words[0]) and _times(words[:1]):
            words = ["0", *words[1:]]
        if len(words) < 8 or not all(map(is_number, words)):
            return False
        numbers = np.array([float(word) for word in words])
        if order and max(order) < len(numbers):
            return _unit(numbers[order[3:]])
        return _unit(numbers[3:7]) or (len(words) > 8 and _unit(numbers[4:8]))

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path)
        raw = _laid_out(decoded(content).splitlines())
        lines = without_comments(raw)
        at = next((n for n, line in enumerate(lines) if line), None)
        if at is None:
            raise FileError(f"Clip {path}: it has no row of numbers. Export it again.")
        delimiter = _delimiter(lines[at])
        lines = [line.rstrip(delimiter) for line in lines]
        words = _words(lines[at], delimiter)
        degrees = [word.lower() for word in words[:7]] == _PROTOMOTIONS
        counted = _counts(words) and any(lines[at + 1 :])
        above = None if degrees else _of_remark(raw[:at], len(words))
        named = degrees or _names([lines[at], ""])
        body = lines[at + (named or counted) :]
        scales, stated = np.ones(len(words)), np.full(len(words), degrees)
        if named and not degrees:
            scales, stated = np.array([_scale(word) for word in words]), _stated(words)
            words = [_UNIT.sub(r"\1", word) if _UNIT.fullmatch(word) else word for word in words]
        first, cells = _row_below(raw[at + named :], delimiter) if named else (0, [])
        cells += [""] * (len(words) - len(cells))
        if not degrees and len(cells) == len(words) and (units := units_in(cells)):
            scales = np.array([scale_of_unit(unit) for unit in units])
            stated = np.array([unit in ("deg", "rad") for unit in units])
            body[first] = ""
        if above is not None:  # the names of np.savetxt
            scales, stated = np.array([_scale(word) for word in above]), _stated(above)
            named = True
            words = [_UNIT.sub(r"\1", word) if _UNIT.fullmatch(word) else word for word in above]
        if delimiter != ",":  # which are decimal then
            body = [line.replace(",", ".") for line in body]
        check_size(path, sum(1 for line in body if line), words)
        timed_body = _with_times(body, delimiter)
        if timed_body is not body:
            body, scales[0] = timed_body, 1.0
        rows = number_rows(path, body, len(lines) - len(body) + 1, len(words), delimiter)
        rows = rows * scales
        said = dict(filter(None, map(said_of, raw[:at])))
        rate = rate_of(path, said["rate"]) if "rate" in said else RATE
        if named and not degrees:
            kept = _as_read(rows, words)
            rows, words, stated = rows[:, kept], [words[n] for n in kept], stated[kept]
        by_name = named and (plain_name(words[0]) == "time" or UNREAD.fullmatch(words[0]))
        timed = not degrees and _timed(rows, 8 if by_name else 9)
        if timed:  # by a column of times, s, or of frames' numbers
            rate = options.rate or _rate(path, rows[:, 0], rate)
            rows, words, stated = rows[:, 1:], words[1:], stated[1:]
        order = _root_columns(words) if named and not degrees else None
        if order:
            rest = [n for n in range(len(words)) if n not in order]
            kept = order + rest
            rows, words, stated = rows[:, kept], [words[n] for n in kept], stated[kept]
        names = [re.sub("_(dof|joint)$", "", word) for word in words[7:]] if named else [
            str(n + 1) for n in range(len(words) - 7)
        ]  # fmt: skip
        joints = ("root", *(f"{ANGLE}{name}" for name in names))
        if len(set(joints)) != len(joints):
            raise FileError(f"Clip {path}: two of its columns have the same name.")
        unit = options.unit and metres_of(options.unit)
        if degrees:
            position, turn, angles = _protomotions(path, rows, unit)
        else:
            position, turn, angles = root_and_angles(path, rows, unit, order is not None)
        angles, assumed = in_radians(path, angles, names, options.angles, stated[7:])
        return Clip(
            name=path.stem,
            times=torch.arange(len(rows), dtype=torch.float64) / (options.rate or rate),
            root_position=torch.from_numpy(position.copy()),
            rotations=angle_rotations(turn, angles),
            joint_names=joints,
            loop=bool(options.loop),
            assumed=assumed,
            **provenance(path, content),
        )


def _names(lines: list[str]) -> bool:
    """Whether the first of `lines` names columns."""
    words = _words(lines[0], _delimiter(lines[0]))
    named = len(words) > 7 and not any(map(is_number, words))
    return len(lines) > 1 and named and not _counts(words)


def _counts(words: list[str]) -> bool:
    """Whether `words` only count columns, as pandas, R (``V1``) and spreadsheets (``Column1``) write them above a table
    without names."""
    words = words[1:] if UNREAD.fullmatch(words[0]) else words
    counted = [_COUNTED.fullmatch(word) for word in words]
    if len(words) < 8 or None in counted or len({match[1] for match in counted if match}) > 1:
        return False
    numbers = [int(match[2]) for match in counted if match]
    return numbers[0] in (0, 1) and numbers == list(range(numbers[0], numbers[0] + len(numbers)))


def _laid_out(raw: Sequence[str]) -> list[str]:
    """The lines of a table without quotes around its cells, in which a decimal comma is a point then; without the
    line ``sep=;`` of spreadsheets; and with a name for R's names of rows."""
    lines = ["" if line.lower().lstrip(' "').startswith("sep=") else line for line in raw]
    for n, line in enumerate(lines):
        if '"' in line and not line.lstrip(' "').startswith(REMARKS):
            between = _delimiter(line) or " "
            with contextlib.suppress(csv.Error):  # then a quote will be no number
                cells = next(csv.reader([line], delimiter=between, skipinitialspace=True), [])
                lines[n] = between.join(cell.strip().replace(",", ".") for cell in cells)
    plain = without_comments(lines)
    at = next((n for n, line in enumerate(plain) if line), None)
    if at is not None:
        lines[at] = with_row_names(lines[at], plain[at + 1 :], _delimiter(lines[at]))
    return lines


def _of_remark(above: Sequence[str], count: int) -> list[str] | None:
    """The names of `count` columns in the last remark `above` the numbers, if the root's are among them."""
    line = next((line.strip().lstrip("#% ") for line in reversed(above) if line.strip()), "")
    words = _words(line, _delimiter(line))
    return words if len(words) == count and _root_columns(words) else None


def _root_columns(words: Sequence[str]) -> list[int] | None:
    """Where x, y, z and the quaternion's x, y, z, w are among columns of these names; None if these do not say it."""
    found: dict[str, list[int]] = {}
    for n, word in enumerate(words):
        if known := _ROOT.fullmatch(_UNIT.sub(r"\1", word) if _UNIT.fullmatch(word) else word):
            found.setdefault((known[1] or f"q{known[2]}").lower(), []).append(n)
    parts = [found.get(part, []) for part in ("x", "y", "z", "qx", "qy", "qz", "qw")]
    return [part[0] for part in parts] if all(len(part) == 1 for part in parts) else None


def _scale(word: str) -> float:
    """m, rad or s in the unit that the name of a column ends with, 1 if with none."""
    if plain_name(word) == "time":
        return scale_of(word)
    named = _UNIT.fullmatch(word)
    units = units_in([named[2] or named[3] or ""]) if named else None
    return scale_of_unit(units[0]) if units else 1.0


def _unit(quaternions: np.ndarray) -> bool:
    """Whether the one (4,), or each of (F, 4), is of length 1."""
    return bool((np.abs(np.linalg.norm(quaternions, axis=-1) - 1.0) < 0.02).all())


def _as_read(rows: np.ndarray, words: Sequence[str]) -> list[int]:
    """The columns of named `words`, that of times first, less those of rows' numbers beside it."""
    times = [n for n, word in enumerate(words) if plain_name(word) == "time"]
    counts = [n for n, word in enumerate(words) if UNREAD.fullmatch(word) and _counted(rows[:, n])]
    left_out = {*times[1:], *(counts if times else counts[1:])}
    first = times[:1] or counts[:1]
    return [*first, *(n for n in range(len(words)) if n not in {*first, *left_out})]


def _counted(column: np.ndarray) -> bool:
    return len(column) > 1 and bool((np.diff(column) == 1.0).all())


def _timed(rows: np.ndarray, least: int) -> bool:
    """Whether the first column counts, or has times, and the quaternion is one further on; of so many columns."""
    if len(rows) < 2 or rows.shape[1] < least:
        return False
    times = rows[:, 0]
    steps = np.diff(times)
    even = bool((steps > 0).all()) and bool(
        np.abs(times - np.linspace(times[0], times[-1], len(times))).max() <= 0.25 * steps.mean()
    )
    return even and _unit_one_further(rows)


def _unit_one_further(rows: np.ndarray) -> bool:
    """Whether the quaternion is one column further on than without times."""
    return _unit(rows[:, 4:8]) and not _unit(rows[:, 3:7])


def _rate(path: Path, times: np.ndarray, unsaid: float) -> float:
    """Frames per second of even `times` (F,), s, which may be rounded; `unsaid` where they are frames' numbers."""
    steps = np.diff(times)
    if (steps == 1.0).all():
        return unsaid
    if steps.mean() > 1.0:
        raise FileError(
            f"Clip {path}: the times in its first column are {steps.mean():.4g} s apart; write them in seconds, or "
            "give motion.rate (--source-rate)."
        )
    rate = float(1.0 / steps.mean())
    whole = round(rate)  # if that is within how the times are rounded
    near = whole and abs(1.0 / whole - steps.mean()) * len(steps) <= np.ptp(steps)
    return float(whole) if near else rate


def _named_in_remark(lines: Sequence[str]) -> bool:
    """Whether a remark above the numbers names a table's columns, whose reader is another."""
    above = itertools.takewhile(
        lambda line: not line.strip() or line.lstrip(' "').startswith("#"), lines
    )
    columns = [plain_name(word) for line in above for word in re.split(r"[\s,;|#\"]+", line)]
    return "root.px" in columns and names_joints(columns)


def _row_below(raw: Sequence[str], delimiter: str | None) -> tuple[int, list[str]]:
    """The first row below the names, with the blanks at both its ends, and its index."""
    for n, line in enumerate(raw):
        if line.strip() and not line.lstrip().startswith(("#", "//")):
            return n, line.split(delimiter)
    return 0, []


def _times(words: Sequence[str]) -> list[float] | None:
    try:
        return since_first(words)
    except ValueError:
        return None


def _with_times(body: list[str], delimiter: str | None) -> list[str]:
    """`body` with seconds where its first column has dates, clocks or counts."""
    if delimiter is None:
        return body
    rows = {i: line.partition(delimiter) for i, line in enumerate(body) if line}
    words = [row[0].strip(' "') for row in rows.values()]
    if not words or is_plain_time(words[0]) or (times := _times(words)) is None:
        return body
    lines = list(body)
    for (i, row), time in zip(rows.items(), times, strict=True):
        lines[i] = f"{time!r}{delimiter}{row[2]}"
    return lines


def _delimiter(line: str) -> str | None:
    return next((mark for mark in ";\t|," if mark in line), None)


def _words(line: str, delimiter: str | None) -> list[str]:
    """Of a `line`, with decimal commas, where others stand between its numbers, as points."""
    words = line.strip().rstrip(delimiter).split(delimiter)
    plain = [word.strip().strip('"').replace(",", ".") for word in words]
    return [w[1:-1] if len(w) > 2 and w[0] == w[-1] == "'" else w for w in plain]


def angle_rotations(turn: np.ndarray, angles: np.ndarray) -> torch.Tensor:
    """(F, 1 + H, 4): the root's rotation (F, 4), and the hinges' turns about x by their angles (F, H) rad."""
    axis = torch.tensor([1.0, 0.0, 0.0], dtype=torch.float64)
    hinges = rotations.from_axis_angle(axis, torch.from_numpy(angles))
    return torch.cat((torch.from_numpy(turn)[:, None], hinges), dim=1)


def in_radians(
    path: Path,
    angles: np.ndarray,
    names: Sequence[str],
    given: AngleUnit | None,
    stated: np.ndarray,
) -> tuple[np.ndarray, bool]:
    """The `angles` (F, H) of the hinges `names` in rad, and whether they are taken for radians though nothing says so. They are
    in the `given` unit but where they are `stated` (H,), which have been scaled.

    Raises
    ------
    FileError
        an angle of no known unit is more than a turn; or a unit is given of a file that says it.
    """
    if given is not None:
        if stated.all() and len(stated):
            raise FileError(
                f"Clip {path}: it says the unit of its angles; leave motion.angles={given} (--angles) out."
            )
        scale = np.where(stated | (given == "radians"), 1.0, np.pi / 180.0)
        return angles * scale, False
    if stated.all():
        return angles, False
    most = np.where(stated, 0.0, np.abs(angles).max(axis=0, initial=0.0))
    cure = "give motion.angles=degrees (--angles degrees)"
    if (swing := float(np.median(most[~stated]))) > _TURN:
        raise FileError(
            f"Clip {path}: half of its angles go beyond {swing:.0f} rad, so they seem to be in degrees; write them in "
            f"radians, or {cure}."
        )
    at = np.flatnonzero((most > _TURN) & ~_goes_on(angles))
    if len(at):
        raise FileError(
            f"Clip {path}: its hinge '{names[at[0]]}' turns to {most[at[0]]:.4g}, in radians more than a turn: {cure}, or "
            "motion.angles=radians if it turns on and on."
        )
    return angles, True


def _goes_on(angles: np.ndarray) -> np.ndarray:
    """(H,) of `angles` (F, H) in rad: whether it is the way of a hinge that turns on and on, a frame after the other."""
    near = np.abs(np.diff(angles, axis=0)).max(axis=0, initial=0.0) < 0.5 * _TURN
    return near & (np.abs(angles[:1]) <= _TURN).all(axis=0)


def _stated(words: Sequence[str]) -> np.ndarray:
    """Of which columns the name says a unit of angles."""
    named = [_UNIT.fullmatch(word) for word in words]
    units = [units_in([match[2] or match[3] or ""]) if match else None for match in named]
    return np.array([bool(unit) and unit[0] in ("deg", "rad") for unit in units])


def root_and_angles(
    path: Path, rows: np.ndarray, unit: float | None, said: bool
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Position (F, 3) m, rotation (F, 4) and angles (F, H) rad of a table whose quaternion is xyzw if its header has
    `said` so, else as it is upright."""
    norms = np.linalg.norm(rows[:, 3:7], axis=1)
    if rows.shape[1] > 8 and len(rows) > 1 and _unit_one_further(rows):
        steps = np.diff(rows[:, 0])
        raise FileError(
            f"Clip {path}: frame {int(np.abs(steps - np.median(steps)).argmax()) + 1}: the times in its first column "
            "are not even; write every frame, or leave the column out."
        )
    if len(rows) and np.abs(norms - 1.0).max() > 0.02:
        frame = int(np.abs(norms - 1.0).argmax())
        raise FileError(
            f"Clip {path}: frame {frame}: columns 4 to 7 are no quaternion; a robot's table without a "
            "header has x, y, z in m, a quaternion as x, y, z, w, then the angles in rad."
        )
    if unit is None and len(rows) and (high := float(np.median(np.abs(rows[:, 2])))) > _FAR:
        raise FileError(
            f"Clip {path}: its root is {high:.0f} m from the floor; write it in metres, or give motion.unit "
            f"(--unit), as {'cm' if high < 300.0 else 'mm'}."
        )
    last, first = rows[:, [6, 3, 4, 5]], rows[:, 3:7]  # what is read as wxyz

    def upright(quaternion: np.ndarray) -> bool:
        up = Rotation.from_quat(quaternion, scalar_first=True).as_matrix()[:, 2, 2]
        return bool(up.mean() > _UPRIGHT)

    scalar_first = not said and len(rows) > 0 and not upright(last) and upright(first)
    return rows[:, :3] * (unit or 1.0), first.copy() if scalar_first else last, rows[:, 7:]


def _protomotions(
    path: Path, rows: np.ndarray, unit: float | None
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    turn = Rotation.from_euler("xyz", rows[:, 4:7], degrees=True).as_quat(scalar_first=True)
    return rows[:, 1:4] * (unit or 0.01), turn, np.radians(rows[:, 7:])
