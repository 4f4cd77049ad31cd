"""The skeleton of an Acclaim motion (ASF): bones, their axes, freedoms and limits; see
:mod:`understudy_motion.readers.amc`."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np

from understudy.errors import FileError
from understudy_motion.limits import check_size, read_bytes
from understudy_motion.readers.text import decoded, is_number, shown

MAX_SKELETON_BYTES = 2**20
UNIT = 0.01
"""What a direction's length may differ from 1 by rounding."""

ROTATIONS = ("rx", "ry", "rz")
POSITIONS = ("tx", "ty", "tz")
SHIFTS = (*POSITIONS, "l")
"""Freedoms of a bone that change its place or length, which a clip's cannot."""


@dataclass
class Bone:
    """A bone, or the root, as the ASF states it. Angles are in the ASF's unit."""

    name: str
    direction: tuple[float, ...] = (0.0, 0.0, 0.0)
    length: float = 0.0
    axis: tuple[float, ...] = (0.0, 0.0, 0.0)
    axis_order: str = "xyz"
    """The axis' turns, the one applied first first."""
    channels: tuple[str, ...] = ()
    """What the values of a frame are, of :data:`ROTATIONS` and, for the root, :data:`POSITIONS`."""

    @property
    def tip(self) -> np.ndarray:
        """(3,) from where the bone begins to where its children do."""
        return self.length * np.array(self.direction)


@dataclass
class Figure:
    """The content of an ASF."""

    bones: list[Bone]
    """The root, then every bone after its parent."""
    parents: list[int]
    position: tuple[float, ...]
    """Where the root is when its values are zero."""
    length_unit: float | None
    """Inches are lengths divided by it; None where the file does not say."""
    degrees: bool | None
    """Whether angles are in degrees, not radians; None where the file does not say."""


def read_figure(path: Path) -> Figure:
    """Read the ASF at `path`.

    Raises
    ------
    FileError
        missing, too large, or not a skeleton; names the line.
    """
    text = decoded(read_bytes(path, MAX_SKELETON_BYTES, what="Skeleton"))
    return _FigureParser(path).parse(text.splitlines())


class _FigureParser:
    """One pass over the lines of an ASF; what a line means depends on the section it is in."""

    def __init__(self, path: Path) -> None:
        self._path = path
        self._line = 0
        self._root = Bone("root")
        self._position: tuple[float, ...] = (0.0, 0.0, 0.0)
        self._length_unit: float | None = None
        self._degrees: bool | None = None
        self._bones = {"root": self._root}
        self._open: Bone | None = None
        self._children: dict[str, list[str]] = {}
        self._parent: dict[str, str] = {}
        self._said: dict[str, set[str]] = {}
        """What the units, the root and the open bone have said of themselves."""
        self._hierarchy: list[tuple[int, list[str]]] = []
        """Lines, by their numbers: bones may come after it."""

    def parse(self, lines: Sequence[str]) -> Figure:
        sections: dict[str, Callable[[list[str]], None]] = {
            ":units": self._units_line,
            ":root": self._root_line,
            ":bonedata": self._bone_line,
            ":hierarchy": lambda words: self._hierarchy.append((self._line, words)),
        }
        section, missing = None, [":root", ":bonedata"]
        for number, line in enumerate(lines, start=1):
            self._line = number
            words = [word.strip('",') for word in plain(line).split()]
            if not words:
                continue
            if words[0].startswith(":"):
                key = words[0].lower()
                section, missing = sections.get(key), [name for name in missing if name != key]
            elif section is not None:
                section(words)
        if missing:
            raise FileError(f"Skeleton {self._path}: is no ASF: it has no section {missing[0]}.")
        if not self._root.channels:
            raise FileError(
                f"Skeleton {self._path}: its section :root has no 'order', which says what the root's numbers are."
            )
        for number, words in self._hierarchy:
            self._line = number
            self._hierarchy_line(words)
        return self._figure()

    def _units_line(self, words: list[str]) -> None:
        key = words[0].lower()
        self._once(":units", key)
        if key == "length":
            length = self._length_unit = self._numbers(words, 1)[0]
            if not 1e-6 <= length <= 1e6:
                self._fail("the unit of length must be above 0")
        elif key == "angle":
            if len(words) != 2 or words[1].lower()[:3] not in ("deg", "rad"):
                self._fail("the unit of angle is 'deg' or 'rad'")
            self._degrees = words[1].lower().startswith("deg")

    def _root_line(self, words: list[str]) -> None:
        key = words[0].lower()
        self._once(":root", key)
        if key == "order":
            self._root.channels = self._channels(words, (*POSITIONS, *ROTATIONS))
        elif key == "axis":
            self._root.axis_order = self._axis_order(words[-1])
        elif key == "position":
            self._position = self._numbers(words, 3)
        elif key == "orientation":
            if len(words) == 5:
                self._root.axis_order = self._axis_order(words.pop())
            self._root.axis = self._numbers(words, 3)

    def _bone_line(self, words: list[str]) -> None:
        key, bone = words[0].lower(), self._open
        if key in ("begin", "end"):
            if bone is None and key == "end":
                self._fail("a bone ends that has not begun")
            if bone is not None:
                self._check(bone)
            self._open, self._said["bone"] = (Bone("") if key == "begin" else None), set()
            return
        if bone is None:
            self._fail("'begin' is expected")
        if key in ("name", "direction", "length", "axis", "dof"):
            self._once("bone", key)
        if key == "name":
            if len(words) != 2 or self._known(words[1]) in self._bones:
                self._fail("a bone's name must be one word that no other bone has")
            bone.name = words[1]
            self._bones[bone.name] = bone
        elif key == "direction":
            bone.direction = self._numbers(words, 3)
            size = float(np.linalg.norm(bone.direction))
            # not rounding: its length alone says how long it is
            if abs(size - 1.0) > UNIT and size > 0.0:
                bone.direction = tuple(part / size for part in bone.direction)
        elif key == "length":
            bone.length = self._numbers(words, 1)[0]
            if bone.length < 0:
                self._fail("a bone's length must be 0 or above")
        elif key == "axis":
            order = "".join(words[4:]) or "xyz"
            bone.axis_order = self._axis_order(order)
            bone.axis = self._numbers(words[:4], 3)
        elif key == "dof":
            bone.channels = self._channels(words, (*ROTATIONS, *SHIFTS))

    def _check(self, bone: Bone) -> None:
        """Refuse what has ended as a bone without saying all that one has to."""
        for key in ("name", "direction", "length"):
            if key not in self._said["bone"]:
                what = f"bone '{bone.name}'" if bone.name else "a bone"
                self._fail(f"{what} ends that has no {key}")
        if bone.length > 0 and not any(bone.direction):
            self._fail(f"bone '{bone.name}' has a length, and its direction is 0 0 0")

    def _once(self, what: str, key: str) -> None:
        """Refuse a statement that `what` has made before."""
        if key in self._said.setdefault(what, set()):
            self._fail(
                f"'{key}' is said twice" + (" of a bone" if what == "bone" else f" in {what}")
            )
        self._said[what].add(key)

    def _hierarchy_line(self, words: list[str]) -> None:
        if words[0].lower() in ("begin", "end") and len(words) == 1:
            return
        words = [self._known(name) for name in words]
        parent, *children = words
        for name in words:
            if name not in self._bones:
                self._fail(f"{shown(name)} is not a bone of this skeleton")
        for child in children:
            if child in self._parent or child == "root":
                self._fail(f"'{child}' hangs on two bones")
            self._parent[child] = parent
        self._children.setdefault(parent, []).extend(children)

    def _figure(self) -> Figure:
        if self._open is not None:  # the last one, without an end
            self._check(self._open)
        check_size(self._path, 1, tuple(self._bones))
        names: list[str] = []
        waiting = ["root"]
        while waiting:
            names.append(waiting.pop())
            waiting.extend(reversed(self._children.get(names[-1], [])))
        if len(names) != len(self._bones):
            loose = next(name for name in self._bones if name not in names)
            raise FileError(f"Skeleton {self._path}: bone '{loose}' does not hang on the root.")
        parents = [-1, *(names.index(self._parent[name]) for name in names[1:])]
        bones = [self._bones[name] for name in names]
        return Figure(bones, parents, self._position, self._length_unit, self._degrees)

    def _known(self, name: str) -> str:
        """The bone that is called so, capitals aside if no other is; else `name` itself."""
        return name if name in self._bones else by_capitals(self._bones).get(name.lower(), name)

    def _numbers(self, words: list[str], count: int) -> tuple[float, ...]:
        if len(words) != count + 1 or not all(map(is_number, words[1:])):
            self._fail(f"'{words[0]}' needs {count} finite {'number' if count == 1 else 'numbers'}")
        return tuple(map(float, words[1:]))

    def _axis_order(self, word: str) -> str:
        if sorted(word.lower()) != ["x", "y", "z"]:
            self._fail(f"{shown(word)} is not an order of the axes, such as XYZ")
        return word.lower()

    def _channels(self, words: list[str], known: Sequence[str]) -> tuple[str, ...]:
        channels = tuple(word.lower() for word in words[1:])
        for channel in channels:
            if channel not in known:
                self._fail(f"{shown(channel)} is not a freedom that is read ({' '.join(known)})")
        if len(set(channels)) != len(channels):
            self._fail("a freedom is listed twice")
        return channels

    def _fail(self, problem: str) -> NoReturn:
        raise FileError(f"Skeleton {self._path}: line {self._line}: {problem}.")


def by_capitals(names: Iterable[str]) -> dict[str, str]:
    """Of small letters the name that is alone in having them."""
    found: dict[str, list[str]] = {}
    for name in names:
        found.setdefault(name.lower(), []).append(name)
    return {lower: alike[0] for lower, alike in found.items() if len(alike) == 1}


def plain(line: str) -> str:
    """`line` without a remark at its end, with points for decimal commas."""
    said = re.sub(r"(^|\s)(#|//).*", "", line) if "#" in line or "/" in line else line
    return re.sub(r"(?<=[0-9]),(?=[0-9])", ".", said) if "," in said else said
