"""Biovision hierarchy (BVH): a skeleton, then Euler angles in degrees, frame by frame; some programs write radians.

The format as described by J. Lander, "Working with Motion Capture File Formats", Game Developer,
January 1998: a joint's rotation is the product of its rotation channels in the order listed, the
last applied first. An End Site is the tip of the joint that it is in; it may have channels, which turn nothing. With all angles zero all frames
are parallel. Of joints with the same name the later ones get a number.

Position channels replace the joint's OFFSET, so constant ones are its bone. Where they would make the
figure a point beside its OFFSETs they are displacements from these. Only the root moves; nodes of a
scene above hips that move are left out, and the hips take their place and turn in the world.
What a program writes below the last frame, such as its name or a list of events, is left out; a second
motion there is refused.

A BVH says neither its unit nor its vertical axis. What is not given is recognised:

- The vertical axis is the one of y and z along which the figure is much the longer, in the pose of
  zeros and in the first frame; one of the two may be undecided (bones laid out along x, crouching).
- The unit of angles is degrees, unless no angle is beyond a turn in radians, and as degrees they would leave a
  figure all but still that travels, or that does not stand on its floor.
- The unit is metres, centimetres, millimetres, inches or feet if that makes the figure an adult, else
  one of the first three if that makes it between 0.4 and 3 m tall, else that of the CMU database
  (1 / 0.45 inch) if that makes it an adult.

Files with y up are taken to face z, as is the custom; see
:func:`understudy_motion.readers.frames.to_world`.
"""

from __future__ import annotations

import contextlib
import itertools
import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import NoReturn

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.limits import MAX_JOINTS, MAX_NAME, check_size, checked_skeleton, read_bytes
from understudy_motion.origin import provenance
from understudy_motion.readers.frames import product_of_turns, to_world
from understudy_motion.readers.guesses import are_radians, may_be_radians, unit_of_height
from understudy_motion.readers.text import decoded, is_number, number_rows, shown, without_comments
from understudy_motion.reading import (
    HEAD_BYTES,
    METRES,
    UNSAID,
    Axis,
    ClipReader,
    ReadOptions,
    metres_of,
)
from understudy_tensors import rotations

TALLER = 1.5
"""How many times longer than along the other axis a figure must be along the vertical one."""
MOVING = 1e-3
"""m that a joint's position may differ from its bone."""
SHIFTED, TRAVELLING = 1e-4, 1e-2
"""Moving and plainly moving, in lengths of all bones together, while the unit is not known."""
SLOWEST = 1.0
"""s between frames: more is a rate, or milliseconds, where seconds belong."""
UNSCALED = 1e-3
"""What a scale may differ from 1."""
COLLAPSED = 0.1
"""Positions whose bones are together so much of the OFFSETs' length are displacements from these."""

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


@dataclass
class Bone:
    """A joint and where it is against its parent, lengths in the file's unit and frame."""

    name: str
    parent: int
    offset: np.ndarray  #: (3,)
    tip: tuple[float, ...] | None
    axes: tuple[int, ...]  #: about which it turns, the last applied first
    angles: np.ndarray  #: (F, axes) degrees
    positions: np.ndarray  #: (F, 3)
    above: int = 0  #: how many of its axes, the first ones, are of nodes above the figure

    def turns(self, up: Axis) -> torch.Tensor:
        """(F, 4), in the frame with z up."""
        return product_of_turns(to_world(np.eye(3)[list(self.axes)], up), np.radians(self.angles))

    def moves(self, distance: float) -> bool:
        """Whether its position changes by more than `distance`."""
        return bool((np.ptp(self.positions, axis=0) > distance).any())


_REMARK = re.compile(r"(^|\s)(#|//|;|%|--)(\s.*)?$")
"""What follows a sign of its own to the end of a line of the hierarchy."""


_NUMBER = re.compile(r"[-+]?\.?[0-9]|[-+]?(nan|inf)", re.IGNORECASE)
"""How a line of a frame begins."""

_SAID = re.compile(
    r"(frames(?![\s_-]*(?:time|rate))|frames?[\s_-]*time|(?:frames?|sample)[\s_-]*rate|fps)\b"
    r"(?:\s*[\[(]\s*(ms|us|µs|s)\w*\s*[\])])?[\s:=]*(\S*(?:\s*/\s*\S+)?(?:\s*(?:[mµu]?s|sec\w*|milli\w*|micro\w*|fps|hz)\b)?)",
    re.IGNORECASE,
)
"""A line, or a part of it, between MOTION and the numbers: what it says, in which unit, and the value."""

_VALUE = re.compile(
    r"([^a-zµ/]*?(?:e[-+]?[0-9]+)?)(?:\s*/\s*([0-9.]+))?\s*(?:(fps|hz)|(s|f|mic|mil|ms|us|µs))?[a-z]*[.,;]?",
    re.IGNORECASE,
)
"""A number or a fraction, and its unit of times or of rates."""
_PARTS = {"ms": 1e3, "mil": 1e3, "us": 1e6, "µs": 1e6, "mic": 1e6}
"""In a second, by what a unit begins with."""


class BvhReader(ClipReader):
    """Reads BVH."""

    fixed = MappingProxyType({"skeleton": None})
    suffixes = (".bvh",)

    def recognises(self, head: bytes, path: Path) -> bool:
        lines = without_comments(decoded(head).splitlines())
        remarks = len(head) == HEAD_BYTES and len(lines) > 1 and not any(lines[:-1])
        if remarks:  # which go on beyond it
            return path.suffix.lower() in self.suffixes
        return any(line[:9].upper() == "HIERARCHY" for line in lines)

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path)
        lines = without_comments(decoded(content).splitlines())
        for i, line in enumerate(lines):  # a remark in whatever marks
            if line[:9].upper() == "HIERARCHY":
                break
            lines[i] = ""
        hierarchy = _Hierarchy(path, lines)
        joints, motion = hierarchy.parse()
        interval, values = _motion(path, lines, motion, joints, hierarchy.columns, options.rate)
        bones = _figure(path, joints, values)

        def clip(bones: Sequence[Bone], up: Axis, metres: float) -> Clip:
            for bone in bones[1:]:
                _check_still(path, bone, metres)
            position = bones[0].positions
            return Clip(
                name=path.stem,
                times=torch.arange(len(position), dtype=torch.float64) / rate,
                root_position=torch.from_numpy(to_world(metres * position, up)),
                rotations=torch.stack([bone.turns(up) for bone in bones], dim=1),
                joint_names=tuple(bone.name for bone in bones),
                loop=bool(options.loop),
                skeleton=_skeleton(path, bones, metres, up),
                **provenance(path, content),
            )

        rate = options.rate or 1.0 / interval
        if options.angles is not None:
            turned = options.angles == "radians"
            bones = _figure(path, joints, values, np.degrees(1.0)) if turned else bones
            return clip(bones, *_recognised(path, bones, options))
        if not may_be_radians(np.concatenate([bone.angles.ravel() for bone in bones])):
            return clip(bones, *_recognised(path, bones, options))
        wide = _figure(path, joints, values, np.degrees(1.0))
        try:
            frame = _recognised(path, bones, options)
        except FileError as error:
            with contextlib.suppress(FileError):
                frame = _recognised(path, wide, options)
                if are_radians(clip(wide, *frame), clip(bones, *frame)):
                    return clip(wide, *frame)
            raise error
        given = clip(bones, *frame)
        with contextlib.suppress(FileError):
            turned = clip(wide, *_recognised(path, wide, options))
            return turned if are_radians(turned, given) else given
        return given


class _Hierarchy:
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
            said = _REMARK.sub("", re.sub(r"/\*.*?\*/", "", line))
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


def _motion(
    path: Path,
    lines: Sequence[str],
    start: int,
    joints: Sequence[Joint],
    parts: Sequence[tuple[int, tuple[tuple[str, int], ...]]],
    rate: float | None,
) -> tuple[float, list[np.ndarray]]:
    """Seconds per frame, and of each joint the values (F, channels) in the file's order.

    Where the `rate` is given the file need not say it, and what it says does not matter.
    """
    count, interval, odd = None, None, ""
    lines = _said_in_one(lines, start)
    head = [
        (i, _REMARK.sub("", line))
        for i, line in itertools.takewhile(
            lambda said: not said[1] or _is_word(said[1].split()[0]),
            enumerate(lines[start : start + 100], start),
        )
        if line
    ]
    for i, word, unit, said in [(i, *said) for i, line in head for said in _SAID.findall(line)]:
        if word.lower() != "frames":
            interval = (i, _seconds(said, unit, word.lower().endswith("time")), said)
        elif number := re.match(r"\+?([0-9]{1,18})(\.0*)?(?:\s|$)|-1$", said):
            count = (i, int(number[1] or 0))  # 0 and -1 of programs that cannot know it yet
        elif said:
            odd = f", and 'Frames' is {shown(said)}"
    last = head[-1][0] if head else start - 1
    unsaid = count is None and any(
        w.lower() == "frames" for _, line in head for w, _, _ in _SAID.findall(line)
    )
    if (interval is None and rate is None) or unsaid:
        raise FileError(
            f"Clip {path}: line {max(last, start) + 1}: 'Frames: <count>' and 'Frame Time: <seconds>' are "
            f"expected after MOTION{odd}; the rate can also be given as motion.rate (--source-rate)."
        )
    seconds = 1.0 / rate if rate else 0.0
    if interval and not rate:
        seconds = interval[1]
        if not 1e-6 <= seconds <= SLOWEST:
            raise FileError(
                f"Clip {path}: line {interval[0] + 1}: 'Frame Time' must be seconds above 0 and up to {SLOWEST:g}, not "
                f"{shown(interval[2])}; or give motion.rate (--source-rate)."
            )
    columns = sum(len(channels) for _, channels in parts)
    if not any(joint.channels for joint in joints):
        raise FileError(f"Clip {path}: no joint has channels, so nothing moves.")
    body = lines[last + 1 :]
    if any(sign in line for line in body for sign in ("#", "//")):
        body = [_REMARK.sub("", line) for line in body]
    body = _without_end(path, body, last + 2, columns)
    frames = sum(1 for line in body if line)
    if frames == 0:
        raise FileError(f"Clip {path}: no frame follows MOTION.")
    if count is not None and frames != count[1] > 0:
        body = _rejoined(body, count[1], columns)
        frames = sum(1 for line in body if line)
    if count is not None and frames != count[1] > 0:
        raise FileError(
            f"Clip {path}: line {count[0] + 1}: {count[1]} frames are announced, but "
            f"{frames} lines of numbers follow. Export or fetch it again; if these are all, write their number there."
        )
    check_size(path, frames, [joint.name for joint in joints])
    if any(";" in line for line in body):
        body = [line.replace(";", " ") for line in body]
    if any("," in line for line in body):  # between numbers, or within
        whole = next(line for line in body if line)
        apart = any("." in line for line in body) or len(whole.split()) != columns
        mark = " " if apart else "."
        body = [line.replace(",", mark) for line in body]
    values = number_rows(path, body, last + 2, columns)
    found = [np.empty((frames, 0)) for _ in joints]
    at = 0
    for joint, channels in parts:
        own = values[:, at : at + len(channels)]
        at += len(channels)
        if joint >= 0:
            found[joint] = own
            continue
        tip = np.zeros(3)  # an end turns nothing, and its place replaces its OFFSET
        for column, (kind, axis) in enumerate(channels):
            if kind == "position":
                tip[axis] = np.median(own[:, column])
        if tip.any():
            joints[-1 - joint].tip = tuple(tip.tolist())
    return seconds, found


def _seconds(said: str, unit: str, time: bool) -> float:
    """Between frames, of what is `said`, a time (in a `unit`, if that is named beside it) or else a rate; 0 if it
    is no number."""
    if not (found := _VALUE.fullmatch(said.strip())):
        return 0.0
    above, below, rate, own = found.groups()
    parts = [p.strip(" ,;").replace(",", ".") for p in (above, below or "1")]
    if not all(map(is_number, parts)) or not float(parts[1]):
        return 0.0
    number = float(parts[0]) / float(parts[1])
    if time and not rate:
        return number / _PARTS.get((own or unit).lower(), 1.0)
    return 1.0 / number if number else 0.0


def _is_word(word: str) -> bool:
    """Whether a line that begins with it has no numbers of a frame."""
    return word[0].isalpha() and word.lower() not in ("nan", "inf", "infinity")


def _said_in_one(lines: Sequence[str], start: int) -> Sequence[str]:
    """`lines` with a value, or the rest of its name, that stands in the line below it beside its name."""
    joined = list(lines)
    words = [i for i, line in enumerate(lines[start : start + 100], start) if line]
    for i, below in itertools.pairwise(words):
        alone = re.fullmatch(r"frame|(.*frame[\s_]*time|frames)[\s:=]*", joined[i], re.IGNORECASE)
        value = is_number(joined[below]) or joined[below].lower().startswith("time")
        if alone and value:
            joined[below], joined[i] = f"{joined[i]} {joined[below]}", ""
    return joined


def _without_end(path: Path, body: Sequence[str], first: int, columns: int) -> Sequence[str]:
    """`body`, whose first line is the file's line `first`, without what stands below its frames."""
    end = next((i for i, line in enumerate(body) if line and not _NUMBER.match(line)), None)
    if end is None:
        return body
    rest = [line.split() for line in body[end:]]
    for number, words in enumerate(rest, start=first + end):
        if words and words[0].upper().rstrip(":") in ("HIERARCHY", "MOTION"):
            raise FileError(
                f"Clip {path}: line {number}: a second motion begins here; save each in a file of its own."
            )
    # What is like a frame shows that it is damage among them.
    among = any(
        len(words) == columns and 2 * sum(map(is_number, words)) > columns for words in rest
    )
    return body if among else body[:end]


def _rejoined(body: Sequence[str], frames: int, columns: int) -> Sequence[str]:
    """`body` with each frame in one line, where its numbers are wrapped; else as it is."""
    words = [line.split() for line in body]
    if sum(map(len, words)) != frames * columns:
        return body
    flat = list(itertools.chain.from_iterable(words))
    return [" ".join(flat[i : i + columns]) for i in range(0, len(flat), columns)]


def _figure(
    path: Path, joints: Sequence[Joint], values: Sequence[np.ndarray], degrees: float = 1.0
) -> list[Bone]:
    """The joints that are the figure's, the first its root, with their bones and angles, of which the file's unit is
    so many `degrees`."""
    bones = []
    for joint, numbers in zip(joints, values, strict=True):
        positions = np.tile(np.array(joint.offset), (len(numbers), 1))
        for column, k in joint.columns("position"):
            positions[:, k] = numbers[:, column]
        sizes = numbers[:, [column for column, _ in joint.columns("scale")]]
        if (np.abs(sizes - 1.0) > UNSCALED).any():
            raise FileError(
                f"Clip {path}: joint '{joint.name}' changes its size; export the motion without scale."
            )
        turning = joint.columns("rotation")
        bones.append(
            Bone(
                joint.name, joint.parent, np.array(joint.offset), joint.tip,
                tuple(k for _, k in turning), degrees * numbers[:, [c for c, _ in turning]], positions,
            )
        )  # fmt: skip
    if len(bones[0].positions):
        _settle_bones(joints, bones)
        bones = _from_root(bones, _top(bones))
    return bones


def _settle_bones(joints: Sequence[Joint], bones: Sequence[Bone]) -> None:
    """Tell positions from displacements, and make each bone what the positions say."""
    placed = [bones[i] for i, joint in enumerate(joints) if i and joint.columns("position")]
    medians = [np.median(bone.positions, axis=0) for bone in placed]
    # Hips below a node of the scene travel, and say nothing about bones.
    said = [
        (np.linalg.norm(median), np.linalg.norm(bone.offset))
        for bone, median in zip(placed, medians, strict=True)
        if bone.parent
    ] or [
        (np.linalg.norm(median), np.linalg.norm(bone.offset))
        for bone, median in zip(placed, medians, strict=True)
    ]
    if said and sum(p for p, _ in said) < COLLAPSED * sum(o for _, o in said):
        for bone in placed:
            bone.positions += bone.offset
        start, root = bones[0].positions[0], bones[0].offset
        if joints[0].columns("position") and np.linalg.norm(start) < np.linalg.norm(start - root):
            bones[0].positions += root
        medians = [np.median(bone.positions, axis=0) for bone in placed]
    near = SHIFTED * _length(bones)
    for bone, median in zip(placed, medians, strict=True):
        if np.abs(median - bone.offset).max() > near:
            bone.offset = median


def _length(bones: Sequence[Bone]) -> float:
    """Of all bones together, but those at the root, which may be a path through the scene."""
    return float(sum(np.linalg.norm(bone.offset) for bone in bones if bone.parent > 0))


def _top(bones: Sequence[Bone]) -> int:
    """The joint that is the figure's root: the hips, where nodes of a scene are above them."""
    length = _length(bones)
    sizes = np.ones(len(bones), dtype=int)
    children: list[list[int]] = [[] for _ in bones]
    for joint in range(len(bones) - 1, 0, -1):
        sizes[bones[joint].parent] += sizes[joint]
        children[bones[joint].parent].append(joint)
    at = top = 0
    still = True
    while children[at]:
        still = still and not bones[at].moves(SHIFTED * length)
        still = still and bool((np.ptp(bones[at].angles, axis=0) <= 1e-3).all())
        main = max(children[at], key=lambda joint: sizes[joint])
        if len(children[at]) == 1:
            if bones[main].moves(SHIFTED * length) and (still or len(children[main]) > 1):
                top = main
        elif still and bones[main].moves(TRAVELLING * length):
            top = main  # beside it are handles and markers, which are not part of the figure
        else:
            break
        at = main
    return top


def _from_root(bones: Sequence[Bone], top: int) -> list[Bone]:
    """The bones of `top` and below; it takes its place and turn in the world."""
    if top == 0:
        return list(bones)
    root = bones[top]
    axes, angles, positions = root.axes, root.angles, root.positions
    at = root.parent
    while at >= 0:
        above = bones[at]
        turn = above.turns("z")
        positions = above.positions + rotations.rotate(turn, torch.from_numpy(positions)).numpy()
        axes = (*above.axes, *axes)
        angles = np.concatenate((above.angles, angles), axis=1)
        at = above.parent
    kept = {top: 0}
    nodes = len(axes) - len(root.axes)
    found = [replace(root, parent=-1, axes=axes, angles=angles, positions=positions, above=nodes)]
    for joint, bone in enumerate(bones):
        if bone.parent in kept:
            kept[joint] = len(found)
            found.append(replace(bone, parent=kept[bone.parent]))
    return found


def _skeleton(path: Path, bones: Sequence[Bone], metres: float, up: Axis) -> Skeleton:
    return checked_skeleton(
        path,
        [bone.name for bone in bones],
        [bone.parent for bone in bones],
        to_world(metres * np.array([bone.offset for bone in bones]), up),
        {b.name: to_world(metres * np.array(b.tip), up) for b in bones if b.tip is not None},
    )


def _check_still(path: Path, bone: Bone, metres: float) -> None:
    """Refuse a joint that moves against its parent: its bone would change length."""
    strays = metres * np.abs(bone.positions - bone.offset).max(axis=1) > MOVING
    if strays.any():
        raise FileError(
            f"Clip {path}: frame {int(strays.argmax())}: joint '{bone.name}' moves against its "
            "parent, by more than 1 mm; only the root may, so export the motion with bones of fixed "
            "length."
        )


def _recognised(path: Path, bones: Sequence[Bone], options: ReadOptions) -> tuple[Axis, float]:
    """The vertical axis and the metres in a unit of length, of which either may be given."""
    up = options.up
    if up is not None and options.unit is not None:
        return up, metres_of(options.unit)
    extents = _extents(path, bones)
    up = up or _vertical(extents)
    if up is None:
        raise FileError(
            f"Clip {path}: which axis is vertical cannot be told from the figure; give motion.up=y "
            "or z (--up)."
        )
    if options.unit is not None:
        return up, metres_of(options.unit)
    metres = unit_of_height(extents[:, "xyz".index(up)].max())
    if metres is None:
        raise FileError(
            f"Clip {path}: its unit of length cannot be told from the figure; give motion.unit, one "
            f"of {', '.join(METRES)}, or the metres in a unit (--unit)."
        )
    return up, metres


def _extents(path: Path, bones: Sequence[Bone]) -> np.ndarray:
    """(3, 3): the figure's size along each axis, file's unit, with zero angles, with those of nodes above
    it alone, and in frame 0."""
    first = [bone.angles[:1] for bone in bones]
    zeros = [a * (np.arange(a.shape[1]) < b.above) for a, b in zip(first, bones, strict=True)]
    turns = [
        torch.stack([replace(b, angles=a).turns("z") for b, a in zip(bones, pose, strict=True)], 1)
        for pose in ([np.zeros_like(a) for a in first], zeros, first)
    ]
    poses = Clip(
        name=path.stem,
        times=torch.arange(3.0),
        root_position=torch.zeros(3, 3),
        rotations=torch.cat(turns),
        joint_names=tuple(bone.name for bone in bones),
        loop=False,
        skeleton=_skeleton(path, bones, 1.0, "z"),
        source=str(path),
    )
    positions, world = forward_kinematics(poses)
    points = torch.cat((positions, tip_positions(poses, positions, world)), dim=1)
    return (points.amax(dim=1) - points.amin(dim=1)).numpy()


def _vertical(extents: np.ndarray) -> Axis | None:
    """The axis along which figures of these sizes (:func:`_extents`) stand, None if that is not plain."""

    def vote(size: np.ndarray) -> Axis | None:
        x, y, z = size
        if y > TALLER * z and y > 0.5 * x:
            return "y"
        return "z" if z > TALLER * y and z > 0.5 * x else None

    votes: list[Axis | None] = [vote(size) for size in extents]
    zeros, turned, first = votes
    axis = turned or zeros
    return None if axis and first and axis != first else axis or first
