"""The part of a BVH before MOTION: joints, what hangs on what, and whose the values of a frame are; see
:mod:`understudy_motion.readers.bvh`."""

from __future__ import annotations

import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

from understudy.errors import FileError
from understudy_motion.limits import MAX_JOINTS, MAX_NAME
from understudy_motion.readers.text import is_number, shown

CHANNELS = {
    name: (kind, k)
    for kind, words in {
        "position": ("position", "pos", "location", "loc", "translation", "translate", "t"),
        "rotation": ("rotation", "rot", "rotate", "angle", "r"),
        "scale": ("scale", "sca"),
    }.items()
    for k, axis in enumerate(("x", "y", "z"))
    for word in words
    for name in (f"{axis}{word}", f"{word}{axis}")
}
"""Kind and axis of a channel by its name in lower case."""


REMARK = re.compile(r"(^|\s)(#|//|;|%|--)(\s.*)?$")
"""What follows a sign of its own to the end of a line of the hierarchy."""


@dataclass
class Joint:
    """A joint as the file states it, lengths in the file's unit and frame."""

    name: str
    parent: int
    offset: tuple[float, ...] | None = None
    channels: tuple[tuple[str, int], ...] = ()
    tip: tuple[float, ...] | None = None

    def columns(self, kind: str) -> list[tuple[int, int]]:
        """Index among the joint's channels, and axis, of those that are a `kind`."""
        return [(i, k) for i, (of, k) in enumerate(self.channels) if of == kind]


class Hierarchy:
    """Reads the part before MOTION, word by word, without recursion."""

    def __init__(self, path: Path, lines: Sequence[str]) -> None:
        self._path = path
        self._words = self._numbered(lines)
        self._line = 1
        #: Whose the values of a frame are, in their order, and what: of a joint, or of the end of joint -1 - n.
        self.columns: list[tuple[int, tuple[tuple[str, int], ...]]] = []

    def parse(self) -> tuple[list[Joint], int]:
        """The joints, parents first, and the index of the line after MOTION."""
        joints: list[Joint] = []
        names: set[str] = set()
        open_joints: list[int] = []
        if self._next().upper().rstrip(":") != "HIERARCHY":
            self._fail("'HIERARCHY' is expected")
        while (word := self._next().upper().rstrip(":")) != "MOTION":
            if word in ("ROOT", "JOINT"):
                if (word == "ROOT" and joints) or (joints and not open_joints):
                    self._fail(
                        "one ROOT is expected, and every JOINT inside it; export each figure by itself"
                    )
                if len(joints) == MAX_JOINTS:
                    self._fail(f"more than {MAX_JOINTS} joints are not read")
                name = self._unused(self._name(), names)
                joints.append(Joint(name, open_joints[-1] if open_joints else -1))
                open_joints.append(len(joints) - 1)
                continue
            if not open_joints:
                self._fail(f"{shown(word)} stands outside of any joint")
            joint = joints[open_joints[-1]]
            if word == "OFFSET":  # as all that follows, perhaps with a colon
                if joint.offset is not None:
                    self._fail(f"joint '{joint.name}' has two OFFSETs")
                joint.offset = self._vector()
            elif word in ("CHANNELS", "CHANNEL"):
                if any(owner == open_joints[-1] for owner, _ in self.columns):
                    self._fail(f"joint '{joint.name}' has two CHANNELS")
                joint.channels = self._channels()
                self.columns.append((open_joints[-1], joint.channels))
            elif word.startswith(("END", "SITE")):
                tip = self._end(open_joints[-1])
                joint.tip = joint.tip or (tip if any(tip) else None)
            elif word == "}":
                if joint.offset is None:
                    self._fail(f"joint '{joint.name}' has no OFFSET")
                open_joints.pop()
            else:
                self._fail(f"{shown(word)} is not part of a joint")
        if not joints or open_joints:
            self._fail("MOTION comes before the hierarchy is complete")
        return joints, self._line

    def _numbered(self, lines: Sequence[str]) -> Iterator[str]:
        for self._line, line in enumerate(lines, start=1):
            said = REMARK.sub("", re.sub(r"/\*.*?\*/", "", line))
            yield from said.replace("{", " { ").replace("}", " } ").split()

    def _next(self) -> str:
        word = next(self._words, None)
        if word is None:
            self._fail("the file ends within the hierarchy")
        return word

    def _expect(self, word: str) -> None:
        if (found := self._next()).upper() != word:
            self._fail(f"'{word}' is expected, not {shown(found)}")

    def _end(self, joint: int) -> tuple[float, ...]:
        """Where the tip is; what the file calls it, before the brace, does not matter."""
        self._words_before_brace()
        tip, word = (0.0, 0.0, 0.0), self._next()
        if word.upper().rstrip(":") == "OFFSET":
            tip, word = self._vector(), self._next()
        if word.upper().rstrip(":") in ("CHANNELS", "CHANNEL"):
            self.columns.append((-1 - joint, self._channels()))
            word = self._next()
        if word != "}":
            self._fail(f"'OFFSET' or '}}' is expected, not {shown(word)}")
        return tip

    @staticmethod
    def _unused(name: str, names: set[str]) -> str:
        """`name`, or it with a number if a joint has it already; added to `names`."""
        numbered = (f"{name}_{number}" for number in itertools.count(2))
        free = name if name not in names else next(n for n in numbered if n not in names)
        names.add(free)
        return free

    def _name(self) -> str:
        words = self._words_before_brace()
        if not words:
            self._fail("a joint has no name")
        return " ".join(words).strip("\"'") or " ".join(words)

    def _words_before_brace(self) -> list[str]:
        words: list[str] = []
        while (word := self._next()) != "{":
            words.append(word)
            if len(" ".join(words)) > MAX_NAME:
                self._fail(
                    f"a joint's name has more than {MAX_NAME} characters, or no '{{' after it"
                )
        return words

    def _vector(self) -> tuple[float, ...]:
        numbers: list[float] = []
        while len(numbers) < 3:
            said = self._next().strip("(),;")
            # Signs between numbers, or a decimal comma.
            mark = ";" if ";" in said or said.count(",") < 2 else ","
            for word in filter(None, (w.replace(",", ".") for w in said.split(mark))):
                if not is_number(word):
                    self._fail(f"OFFSET needs three numbers, not {shown(word)}")
                numbers.append(float(word))
        if len(numbers) > 3:
            self._fail("OFFSET needs three numbers")
        return tuple(numbers)

    def _channels(self) -> tuple[tuple[str, int], ...]:
        count = self._next().strip(",:")
        if not re.fullmatch("0?[0-9]", count):
            self._fail(f"a joint has from 0 to 9 CHANNELS, not {shown(count)}")
        names = [re.sub(r"[\W_]", "", self._next().lower()) for _ in range(int(count))]
        for name in names:
            if name not in CHANNELS or names.count(name) > 1:
                self._fail(f"{shown(name)} is not a channel, or is listed twice")
        return tuple(CHANNELS[name] for name in names)

    def _fail(self, problem: str) -> NoReturn:
        raise FileError(f"Clip {self._path}: line {self._line}: {problem}.")
