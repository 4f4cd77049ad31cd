"""Biovision hierarchy (BVH): a skeleton, then Euler angles in degrees, frame by frame.

The format as described by J. Lander, "Working with Motion Capture File Formats", Game Developer,
January 1998: a joint's rotation is the product of its rotation channels in the order listed, the
last applied first. Position channels replace the joint's OFFSET; only the root's may move it. An
End Site is the tip of the joint that it is in. With all angles zero all frames are parallel.

A BVH says neither its unit nor its vertical axis. What is not given is recognised:

- The vertical axis is the one of y and z along which the figure is much the longer, in the pose of
  zeros and in the first frame; one of the two may be undecided (bones laid out along x, crouching).
- The unit is metres, centimetres, millimetres or inches if that makes the figure an adult, else one
  of the first three if that makes it between 0.4 and 3 m tall.

Files with y up are taken to face z, as is the custom; see
:func:`understudy_motion.readers.frames.to_world`.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NoReturn

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.kinematics import forward_kinematics, tip_positions
from understudy_motion.readers.frames import product_of_turns, to_world
from understudy_motion.readers.text import is_number, number_rows, shown
from understudy_motion.reading import (
    MAX_JOINTS,
    MAX_NAME,
    METRES,
    UNSAID,
    Axis,
    ClipReader,
    ReadOptions,
    Unit,
    check_size,
    checked_skeleton,
    provenance,
    read_bytes,
)

ADULT = (1.2, 2.3)
"""m, heights between a figure's lowest and highest point that leave no doubt about the unit."""
PLAUSIBLE = (0.4, 3.0)
"""m, heights that decide between units a power of ten apart."""
TALLER = 1.5
"""How many times longer than along the other axis a figure must be along the vertical one."""
MOVING = 1e-3
"""m that a position channel may differ from its joint's OFFSET."""

CHANNELS = {
    f"{axis}{kind}": (kind, k)
    for kind in ("position", "rotation")
    for k, axis in enumerate(("x", "y", "z"))
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


class BvhReader(ClipReader):
    """Reads BVH."""

    suffixes = (".bvh",)

    def recognises(self, head: bytes, path: Path) -> bool:
        return head.removeprefix(b"\xef\xbb\xbf").lstrip()[:9].upper() == b"HIERARCHY"

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path)
        lines = content.decode("utf-8-sig", errors="replace").splitlines()
        joints, motion = _Hierarchy(path, lines).parse()
        interval, values = _motion(path, lines, motion, joints)
        rate = options.rate or 1.0 / interval
        up, unit = options.up, options.unit
        if up is None or unit is None:
            up, unit = _recognised(path, joints, values, up, unit)
        for joint, numbers in zip(joints[1:], values[1:], strict=True):
            _check_still(path, joint, numbers, METRES[unit])

        position = np.tile(np.array(joints[0].offset), (len(values[0]), 1))
        for column, k in joints[0].columns("position"):
            position[:, k] = values[0][:, column]
        return Clip(
            name=path.stem,
            times=torch.arange(len(position), dtype=torch.float64) / rate,
            root_position=torch.from_numpy(to_world(METRES[unit] * position, up)),
            rotations=_rotations(joints, values, up),
            joint_names=tuple(joint.name for joint in joints),
            loop=bool(options.loop),
            skeleton=_skeleton(path, joints, METRES[unit], up),
            **provenance(path, content),
        )


class _Hierarchy:
    """Reads the part before MOTION, word by word, without recursion."""

    def __init__(self, path: Path, lines: Sequence[str]) -> None:
        self._path = path
        self._words = self._numbered(lines)
        self._line = 1

    def parse(self) -> tuple[list[Joint], int]:
        """The joints, parents first, and the index of the line after MOTION."""
        joints: list[Joint] = []
        open_joints: list[int] = []
        if self._next().upper() != "HIERARCHY":
            self._fail("'HIERARCHY' is expected")
        while (word := self._next().upper()) != "MOTION":
            if word in ("ROOT", "JOINT"):
                if (word == "ROOT") != (not joints) or (joints and not open_joints):
                    self._fail("one ROOT is expected, and every JOINT inside it")
                if len(joints) == MAX_JOINTS:
                    self._fail(f"more than {MAX_JOINTS} joints are not read")
                name = self._name()
                joints.append(Joint(name, open_joints[-1] if open_joints else -1))
                open_joints.append(len(joints) - 1)
                continue
            if not open_joints:
                self._fail(f"{shown(word)} stands outside of any joint")
            joint = joints[open_joints[-1]]
            if word == "OFFSET":
                if joint.offset is not None:
                    self._fail(f"joint '{joint.name}' has two OFFSETs")
                joint.offset = self._vector()
            elif word == "CHANNELS":
                joint.channels = self._channels()
            elif word == "END":
                for expected in ("SITE", "{", "OFFSET"):
                    self._expect(expected)
                tip = self._vector()
                self._expect("}")
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
            yield from line.replace("{", " { ").replace("}", " } ").split()

    def _next(self) -> str:
        word = next(self._words, None)
        if word is None:
            self._fail("the file ends within the hierarchy")
        return word

    def _expect(self, word: str) -> None:
        if (found := self._next()).upper() != word:
            self._fail(f"'{word}' is expected, not {shown(found)}")

    def _name(self) -> str:
        words = []
        while (word := self._next()) != "{":
            words.append(word)
            if len(" ".join(words)) > MAX_NAME:
                self._fail(
                    f"a joint's name has more than {MAX_NAME} characters, or no '{{' after it"
                )
        if not words:
            self._fail("a joint has no name")
        return " ".join(words)

    def _vector(self) -> tuple[float, ...]:
        numbers = []
        for _ in range(3):
            word = self._next()
            if not is_number(word):
                self._fail(f"OFFSET needs three numbers, not {shown(word)}")
            numbers.append(float(word))
        return tuple(numbers)

    def _channels(self) -> tuple[tuple[str, int], ...]:
        count = self._next()
        if count not in tuple("0123456"):
            self._fail(f"a joint has from 0 to 6 CHANNELS, not {shown(count)}")
        names = [self._next().lower() for _ in range(int(count))]
        for name in names:
            if name not in CHANNELS or names.count(name) > 1:
                self._fail(f"{shown(name)} is not a channel, or is listed twice")
        return tuple(CHANNELS[name] for name in names)

    def _fail(self, problem: str) -> NoReturn:
        raise FileError(f"Clip {self._path}: line {self._line}: {problem}.")


def _motion(
    path: Path, lines: Sequence[str], start: int, joints: Sequence[Joint]
) -> tuple[float, list[np.ndarray]]:
    """Seconds per frame, and of each joint the values (F, channels) in the file's order."""
    said = [(i, line) for i, line in enumerate(lines[start : start + 100], start) if line.strip()]
    if len(said) < 2:
        raise FileError(f"Clip {path}: 'Frames:' and 'Frame Time:' are missing after MOTION.")
    (_, first), (last, second) = said[:2]
    frames = re.fullmatch(r"\s*frames\s*:\s*([0-9]{1,9})\s*", first, re.IGNORECASE)
    interval = re.fullmatch(r"\s*frame\s+time\s*:\s*(\S+)\s*", second, re.IGNORECASE)
    if frames is None or interval is None:
        raise FileError(
            f"Clip {path}: line {last + 1}: 'Frames: <count>' and 'Frame Time: <seconds>' are "
            "expected after MOTION."
        )
    if not is_number(interval[1]) or not 1e-6 <= float(interval[1]) <= 1e3:
        raise FileError(f"Clip {path}: line {last + 1}: 'Frame Time' must be seconds above 0.")
    columns = sum(len(joint.channels) for joint in joints)
    if columns == 0:
        raise FileError(f"Clip {path}: no joint has channels, so nothing moves.")
    body = lines[last + 1 :]
    count = sum(1 for line in body if line.strip())
    if count != int(frames[1]):
        raise FileError(
            f"Clip {path}: line {said[0][0] + 1}: {int(frames[1])} frames are announced, but "
            f"{count} lines of numbers follow."
        )
    check_size(path, count, [joint.name for joint in joints])
    values = number_rows(path, body, last + 2, columns)
    ends = np.cumsum([len(joint.channels) for joint in joints])
    return float(interval[1]), np.split(values, ends[:-1], axis=1)


def _rotations(joints: Sequence[Joint], values: Sequence[np.ndarray], up: Axis) -> torch.Tensor:
    """(F, J, 4), in the frame with z up."""
    local = []
    for joint, numbers in zip(joints, values, strict=True):
        turning = joint.columns("rotation")
        axes = np.eye(3)[[k for _, k in turning]]
        angles = np.radians(numbers[:, [column for column, _ in turning]])
        local.append(product_of_turns(to_world(axes, up), angles))
    return torch.stack(local, dim=1)


def _skeleton(path: Path, joints: Sequence[Joint], metres: float, up: Axis) -> Skeleton:
    return checked_skeleton(
        path,
        [joint.name for joint in joints],
        [joint.parent for joint in joints],
        to_world(metres * np.array([joint.offset for joint in joints]), up),
        {j.name: to_world(metres * np.array(j.tip), up) for j in joints if j.tip is not None},
    )


def _check_still(path: Path, joint: Joint, values: np.ndarray, metres: float) -> None:
    """Refuse a joint whose position channels are not its OFFSET: its bone would change length."""
    assert joint.offset is not None
    for column, k in joint.columns("position"):
        strays = metres * np.abs(values[:, column] - joint.offset[k]) > MOVING
        if strays.any():
            raise FileError(
                f"Clip {path}: frame {int(strays.argmax())}: joint '{joint.name}' moves from its "
                "OFFSET; only the root may, so export the motion with bones of fixed length."
            )


def _recognised(
    path: Path,
    joints: Sequence[Joint],
    values: Sequence[np.ndarray],
    up: Axis | None,
    unit: Unit | None,
) -> tuple[Axis, Unit]:
    """The vertical axis and the unit, of which one may be given."""
    extents = _extents(path, joints, values)
    up = up or _vertical(extents)
    if up is None:
        raise FileError(
            f"Clip {path}: which axis is vertical cannot be told from the figure; give motion.up=y "
            "or z (--up)."
        )
    unit = unit or _unit_of_height(extents[:, "xyz".index(up)].max())
    if unit is None:
        raise FileError(
            f"Clip {path}: its unit of length cannot be told from the figure; give motion.unit, one "
            f"of {', '.join(METRES)} (--unit)."
        )
    return up, unit


def _extents(path: Path, joints: Sequence[Joint], values: Sequence[np.ndarray]) -> np.ndarray:
    """(2, 3): the figure's size along each axis, file's unit, with zero angles and in frame 0."""
    first = _rotations(joints, [numbers[:1] for numbers in values], "z")
    zeros = torch.zeros_like(first)
    zeros[..., 0] = 1.0
    poses = Clip(
        name=path.stem,
        times=torch.tensor([0.0, 1.0]),
        root_position=torch.zeros(2, 3),
        rotations=torch.cat((zeros, first)),
        joint_names=tuple(joint.name for joint in joints),
        loop=False,
        skeleton=_skeleton(path, joints, 1.0, "z"),
        source=str(path),
    )
    positions, world = forward_kinematics(poses)
    points = torch.cat((positions, tip_positions(poses, positions, world)), dim=1)
    return (points.amax(dim=1) - points.amin(dim=1)).numpy()


def _vertical(extents: np.ndarray) -> Axis | None:
    """The axis along which figures of these sizes (2, 3) stand, None if that is not plain."""
    votes: set[Axis] = set()
    for x, y, z in extents:
        if y > TALLER * z and y > 0.5 * x:
            votes.add("y")
        if z > TALLER * y and z > 0.5 * x:
            votes.add("z")
    return votes.pop() if len(votes) == 1 else None


def _unit_of_height(height: float) -> Unit | None:
    candidates: tuple[tuple[Unit, tuple[float, float]], ...] = (
        *((unit, ADULT) for unit in ("m", "cm", "mm", "inch")),
        *((unit, PLAUSIBLE) for unit in ("m", "cm", "mm")),
    )
    for unit, (least, most) in candidates:
        if least <= height * METRES[unit] <= most:
            return unit
    return None
