"""Acclaim motion (AMC) on its skeleton (ASF), as in the CMU Graphics Lab Motion Capture Database.

The formats as described by J. Lander, "Working with Motion Capture File Formats", Game Developer,
January 1998. A bone of the ASF hangs on the tip of its parent, and its own tip lies ``length`` along
``direction``, both in the figure's frame (y up, z forward, x left). Its axis C is a product of turns
about x, y and z; the motion M of a frame is the product of turns by the values of the frame, the one
listed first applied first. The bone turns by C M C⁻¹ relative to its parent, so in the skeleton's
own pose all frames are parallel. The root is read as a bone whose axis is its ``orientation``. A
clip's joint sits where its bone begins.

Lengths are in inches divided by the ``length`` of the ASF's ``:units`` (0.45 in CMU's files), unless
the unit is given, by its name in place of inches or as the metres in one of the file's numbers; a figure that is then
smaller than 0.4 m or larger than 3 m is refused. Without that line the unit is the one that makes the figure an adult.
Angles are in the unit that the
AMC says, else in the ASF's, else as in BVH. Most AMC have no frame rate: :data:`DEFAULT_RATE`, at which CMU's were recorded,
unless one is given (some of CMU's clips are of 60 frames/s), or a line ``:SAMPLES-PER-SECOND`` says it.

Remarks (``#``, ``//``), capitals, decimal commas and the bones' order in a frame do not matter. Bones may have the
freedoms to shift and to grow (``tx``, ``l``) as long as they use none.
"""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import MappingProxyType

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.library import DATA_VARIABLE, data_folder
from understudy_motion.limits import check_size, checked_skeleton, read_bytes
from understudy_motion.origin import provenance
from understudy_motion.readers.asf import (
    POSITIONS,
    ROTATIONS,
    SHIFTS,
    Bone,
    Figure,
    by_capitals,
    plain,
    read_figure,
)
from understudy_motion.readers.frames import product_of_turns, to_world
from understudy_motion.readers.guesses import (
    MOST_RADIANS,
    PLAUSIBLE,
    are_radians,
    may_be_radians,
    unit_of_height,
)
from understudy_motion.readers.text import LARGEST, decoded, is_number, shown, without_comments
from understudy_motion.reading import (
    METRES,
    UNSAID,
    Axis,
    ClipReader,
    ReadOptions,
    metres_of,
    no_rate,
)
from understudy_tensors import rotations

DEFAULT_RATE = 120.0
"""Frames per second of CMU's clips."""

SHIFTED = 1e-3
"""m by which a bone may do so."""

_RATE = re.compile(r":\s*(?:samples-per-second|frame[-_ ]?rate|fps)\s*[:=]?\s*(\S*)")
"""A line of the header, in small letters."""


class AmcReader(ClipReader):
    """Reads AMC, with the ASF that belongs to it."""

    fixed = MappingProxyType({})
    suffixes = (".amc",)

    def recognises(self, head: bytes, path: Path) -> bool:
        lines = [line for line in without_comments(decoded(head).splitlines()) if line]
        if not lines:
            return False
        if _frame_number(lines[0]) is not None and len(lines) > 1:  # without a header
            return lines[1].split()[0].lower() == "root"
        return lines[0].startswith(":")

    def needs(self, path: Path, options: ReadOptions) -> Sequence[Path]:
        return () if options.skeleton else (_skeleton_of(path),)

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path)
        lines = [plain(line) for line in decoded(content).splitlines()]
        start, said, rate = _header(path, lines)
        figure_path = options.skeleton or _skeleton_of(path)
        figure = read_figure(figure_path)
        values = _values(path, lines, start, figure.bones, figure_path)

        up = options.up or "y"
        metres = _metres(figure_path, figure, options, up)
        position = np.tile(figure.position, (len(values[0]), 1))
        for column, channel in enumerate(figure.bones[0].channels):
            if channel in POSITIONS:
                position[:, POSITIONS.index(channel)] += values[0][:, column]
        for bone, numbers in zip(figure.bones[1:], values[1:], strict=True):
            _check_still(path, bone, metres * numbers)

        wide = max(abs(angle) for bone in figure.bones for angle in bone.axis) > MOST_RADIANS

        def clip(degrees: bool) -> Clip:
            unit = np.pi / 180.0 if degrees else 1.0
            axes = degrees or wide if figure.degrees is None else figure.degrees
            joints = [
                _local_rotation(bone, numbers * unit, _axis(bone, axes), up)
                for bone, numbers in zip(figure.bones, values, strict=True)
            ]
            return Clip(
                name=path.stem,
                times=torch.arange(len(position), dtype=torch.float64) / (options.rate or rate),
                root_position=torch.from_numpy(to_world(metres * position, up)),
                rotations=torch.stack(joints, dim=1),
                joint_names=tuple(bone.name for bone in figure.bones),
                loop=bool(options.loop),
                skeleton=_skeleton(figure_path, figure, metres, up),
                **provenance(path, content),
            )

        stated = figure.degrees if said is None else said
        if options.angles is not None:
            given = options.angles == "degrees"
            if stated not in (None, given):
                raise FileError(
                    f"Clip {path}: it says that its angles are in {'degrees' if stated else 'radians'}; leave "
                    f"motion.angles={options.angles} (--angles) out."
                )
            stated = given
        if stated is not None or not may_be_radians(_angles(figure.bones, values)):
            return clip(True if stated is None else stated)
        degrees, radians = clip(True), clip(False)
        return radians if are_radians(radians, degrees) else degrees


def _check_still(path: Path, bone: Bone, values: np.ndarray) -> None:
    """Refuse a bone that is shifted or grows, by `values` (F, channels) in m."""
    columns = [column for column, channel in enumerate(bone.channels) if channel in SHIFTS]
    if (np.abs(values[:, columns]) > SHIFTED).any():
        frame = int((np.abs(values[:, columns]) > SHIFTED).any(axis=1).argmax())
        raise FileError(
            f"Clip {path}: frame {frame}: bone '{bone.name}' moves against its parent, by more than 1 mm; only the "
            "root may, so export the motion with bones of fixed length."
        )


def _skeleton_of(path: Path) -> Path:
    """The ASF of the clip's subject (``02.asf`` of ``02_01.amc``) beside it, else the only one there,
    else the subject's in the data folder."""
    try:
        found = sorted(p for p in path.parent.iterdir() if p.suffix.lower() == ".asf")
    except OSError as error:
        raise FileError(f"Clip {path}: its folder cannot be read: {error}.") from error
    subject = path.stem.partition("_")[0]
    for candidate in found:
        if candidate.stem == subject:
            return candidate
    if len(found) == 1:
        return found[0]
    data = data_folder()
    if data is not None and (known := data / "motions" / "cmu" / f"{subject}.asf").is_file():
        return known
    have = f"{len(found)} skeletons, but no {subject}.asf," if found else "no skeleton (.asf)"
    raise FileError(
        f"Clip {path}: there is {have} beside it, nor is it in "
        f"${DATA_VARIABLE}/motions/cmu; give motion.skeleton=PATH (--skeleton)."
    )


def _metres(path: Path, figure: Figure, options: ReadOptions, up: Axis) -> float:
    """The metres in a unit of the figure: as given, as its file says, else as its height shows."""
    if options.unit and not isinstance(options.unit, str):
        return float(options.unit)  # a number of metres is that of the file's own numbers
    stated = 1.0 / (figure.length_unit or 1.0)
    if options.unit:
        return metres_of(options.unit) * stated
    places = [np.zeros(3)]
    tips = [figure.bones[0].tip]
    for bone, parent in zip(figure.bones[1:], figure.parents[1:], strict=True):
        places.append(tips[parent])
        tips.append(tips[parent] + bone.tip)
    extents = np.ptp(np.array(places + tips), axis=0)
    if figure.length_unit is not None:
        metres = metres_of("inch") * stated
        least, most = PLAUSIBLE
        if not least <= (size := float(extents.max()) * metres) <= most:
            raise FileError(
                f"Skeleton {path}: by its section :units (inches divided by {figure.length_unit:g}) the figure is {size:.3g} m from "
                f"end to end, and figures are {least:g} to {most:g} m. Give motion.unit (--unit): one of {', '.join(METRES)}, before "
                "that division, or the metres in one of the file's numbers; inch if this is its size."
            )
        return metres
    metres = unit_of_height(float(extents["xyz".index(up)]))
    if metres is None:
        raise FileError(
            f"Skeleton {path}: it has no section :units, and its unit of length cannot be told from the figure; give "
            f"motion.unit, one of {', '.join(METRES)}, or the metres in a unit (--unit)."
        )
    return metres


def _angles(bones: Sequence[Bone], values: Sequence[np.ndarray]) -> np.ndarray:
    """All angles of the motion, in one row."""
    turning = [[c in ROTATIONS for c in bone.channels] for bone in bones]
    return np.concatenate([v[:, t].ravel() for v, t in zip(values, turning, strict=True)])


def _header(path: Path, lines: Sequence[str]) -> tuple[int, bool | None, float]:
    """The index of the first frame's line, whether angles are in degrees if it says so, and the frames per second."""
    degrees, given = None, None
    for index, line in enumerate(lines):
        word = line.strip().lower()
        if _frame_number(word) is not None:
            return index, degrees, given or DEFAULT_RATE
        if word in (":units", ":root", ":bonedata", ":hierarchy"):
            raise FileError(
                f"Clip {path}: is a skeleton (ASF) without a motion; give the AMC that belongs to it."
            )
        if (key := word.replace(" ", "")) in (":degrees", ":radians"):
            if degrees is (key == ":radians"):
                raise FileError(
                    f"Clip {path}: line {index + 1}: it says both :DEGREES and :RADIANS; keep the one that is so."
                )
            degrees = key == ":degrees"
        elif said := _RATE.match(word):
            if not is_number(said[1]) or not 0.0 < float(said[1]) <= 1e6:
                raise FileError(
                    f"Clip {path}: line {index + 1}: {shown(said[1])} is no number of frames per second."
                )
            rate = float(said[1])
            if given not in (None, rate):
                raise FileError(
                    f"Clip {path}: line {index + 1}: it says both {given:g} and {rate:g} frames per second."
                )
            given = rate
            if why := no_rate(rate):
                raise FileError(f"Clip {path}: line {index + 1}: {rate:g} is no rate: {why}.")
        elif word and not word.startswith(("#", ":")):
            raise FileError(
                f"Clip {path}: line {index + 1}: {shown(line.strip())} is no AMC header."
            )
    raise FileError(f"Clip {path}: has no frames.")


def _frame_number(line: str) -> int | None:
    word = line.strip()
    return int(word) if word.isascii() and word.isdecimal() and len(word) < 10 else None


def _values(
    path: Path, lines: list[str], start: int, bones: Sequence[Bone], figure_path: Path
) -> list[np.ndarray]:
    """Of each bone the values (F, channels); all frames must list the bones as the first does."""
    rows = [line for line in lines[start:] if line.strip()]
    by_name = {bone.name: bone for bone in bones if bone.channels}
    known = by_capitals(by_name)
    still = {bone.name.lower() for bone in bones if not bone.channels}
    end = next(
        (i for i, row in enumerate(rows[1:], 1) if _frame_number(row) is not None), len(rows)
    )
    if any(row.strip().lower() in still for row in rows[:end]):  # named, and without values
        rows = [row for row in rows if row.strip().lower() not in still]
    if any((name := row.split()[0]) not in by_name and name.lower() in known for row in rows[:end]):
        rows = [_renamed(row, by_name, known) for row in rows]
    listed: list[str] = []
    for row in rows[1:]:
        if _frame_number(row) is not None:
            break
        name = row.split()[0]
        if name in listed:
            raise FileError(f"Clip {path}: {shown(name)} is listed twice in its first frame.")
        if name not in by_name:
            raise FileError(
                f"Clip {path}: {shown(name)} in its first frame is not one of the moving bones of "
                f"{figure_path}. Give the ASF that belongs to it: motion.skeleton=PATH (--skeleton)."
            )
        listed.append(name)
    if missing := next((name for name in by_name if name not in listed), None):
        raise FileError(
            f"Clip {path}: its first frame has no '{missing}', which is a moving bone of {figure_path}. "
            "Give the ASF that belongs to it: motion.skeleton=PATH (--skeleton)."
        )
    height = 1 + len(listed)
    ordered: list[str] | None = None
    check_size(path, len(rows) // height, [bone.name for bone in bones])
    numbers = [_frame_number(row) for row in rows[::height]]
    counted = numbers == list(range(int(rows[0]), int(rows[0]) + len(numbers)))
    whole = counted and len(rows) % height == 0
    found: dict[str, np.ndarray] = {}
    for offset, name in enumerate(listed, start=1):
        count = len(by_name[name].channels)
        values = _bone_values((ordered or rows)[offset::height], name, count)
        if values is None and whole and ordered is None:
            ordered = _in_order(rows, listed)
            values = _bone_values(ordered[offset::height], name, count)
        if not whole or values is None:
            raise FileError(f"Clip {path}: {_fault(lines, start, height, listed, by_name)}.")
        found[name] = values
    return [found.get(bone.name, np.empty((len(rows) // height, 0))) for bone in bones]


def _renamed(row: str, by_name: Mapping[str, Bone], known: Mapping[str, str]) -> str:
    """`row` with its bone's name as the skeleton writes it."""
    name, *rest = row.split()
    return " ".join((name if name in by_name else known.get(name.lower(), name), *rest))


def _in_order(rows: list[str], listed: Sequence[str]) -> list[str]:
    """`rows` with the bones of each frame in the order `listed`; as they are where a frame has others."""
    height = 1 + len(listed)
    first = [row.split()[0] for row in rows[1:height]]
    ordered = list(rows)
    place = {name: at for at, name in enumerate(first)}
    for start in range(0, len(rows) - height + 1, height):
        names = [row.split()[0] for row in rows[start + 1 : start + height]]
        if names == first:
            continue
        if set(names) != set(first):
            return rows
        for name, row in zip(names, rows[start + 1 : start + height], strict=True):
            ordered[start + 1 + place[name]] = row
    return ordered


def _bone_values(rows: Sequence[str], name: str, count: int) -> np.ndarray | None:
    """(F, count) of rows that are the bone's name and its values, or None if one is not."""
    try:
        parsed = np.loadtxt(
            rows,
            dtype=[("name", f"U{len(name) + 1}"), ("values", np.float64, (count,))],
            comments=None,
            ndmin=1,
        )
    except (ValueError, OverflowError):
        return None
    fine = (parsed["name"] == name).all() and (np.abs(parsed["values"]) <= LARGEST).all()
    return parsed["values"] if fine else None


def _fault(
    lines: Sequence[str],
    start: int,
    height: int,
    listed: Sequence[str],
    by_name: dict[str, Bone],
) -> str:
    """What is wrong with the first line that is not as it should be."""
    rows = [
        (i, line.strip()) for i, line in enumerate(lines, start=1) if i > start and line.strip()
    ]
    first = int(rows[0][1])
    for index, (number, row) in enumerate(rows):
        frame, offset = divmod(index, height)
        if offset == 0:
            if _frame_number(row) != first + frame:
                return f"line {number}: the number {first + frame} of a frame is expected, not {shown(row)}"
            continue
        name = listed[offset - 1]
        count = len(by_name[name].channels)
        words = row.split()
        if words[0] != name or len(words) != count + 1 or not all(map(is_number, words[1:])):
            return (
                f"line {number}: '{name}' and {count} finite number{'s' * (count > 1)} are "
                f"expected, not {shown(row)}"
            )
    return "its last frame is incomplete"


def _axis(bone: Bone, degrees: bool) -> np.ndarray:
    """(3, 3): the rotation C of the bone's axis."""
    angles = np.array(bone.axis) * (np.pi / 180.0 if degrees else 1.0)
    order = ["xyz".index(letter) for letter in reversed(bone.axis_order)]
    turn = product_of_turns(np.eye(3)[order], angles[None, order])
    return rotations.to_matrix(turn)[0].numpy()


def _local_rotation(bone: Bone, angles: np.ndarray, axis: np.ndarray, up: Axis) -> torch.Tensor:
    """C M C⁻¹, (F, 4): the turns of M about the axes that C has turned."""
    turning = [
        (column, ROTATIONS.index(channel))
        for column, channel in reversed(list(enumerate(bone.channels)))
        if channel in ROTATIONS
    ]
    about = axis.T[[k for _, k in turning]]
    return product_of_turns(to_world(about, up), angles[:, [column for column, _ in turning]])


def _skeleton(path: Path, figure: Figure, metres: float, up: Axis) -> Skeleton:
    ends = [to_world(metres * bone.tip, up) for bone in figure.bones]
    names = [bone.name for bone in figure.bones]
    leaves = set(range(1, len(names))) - set(figure.parents)
    return checked_skeleton(
        path,
        names,
        figure.parents,
        np.stack([np.zeros(3), *(ends[parent] for parent in figure.parents[1:])]),
        {names[leaf]: ends[leaf] for leaf in sorted(leaves)},
    )
