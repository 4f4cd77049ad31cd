"""DeepMimic JSON clips (Peng et al., "DeepMimic", SIGGRAPH 2018; the released data's layout).

A file holds ``Loop`` ("wrap" or "none") and ``Frames``, rows of 44 numbers: the frame's duration in
seconds, the root position in metres, the root rotation, then the joints of :data:`JOINTS` in order,
a quaternion wxyz for a spherical joint and an angle in radians for a revolute one. The duration of
the last row is not used; in a wrap clip the last row is the first pose of the next cycle.

The file's frame is y up, x forward, z to the right. A vector (x, y, z) becomes (x, -z, y) and a
quaternion (w, x, y, z) becomes (w, x, -z, y). Revolute joints turn about the file's +z, our -y.

The files carry no skeleton; the clips get the one they were made for (:data:`OFFSETS`).

Files come from anywhere: whatever is wrong with one is a :class:`FileError`.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from types import MappingProxyType
from typing import Any, NoReturn

import numpy as np
import torch

from understudy.errors import FileError, suggestion
from understudy_motion.clip import Clip, Skeleton
from understudy_motion.limits import read_bytes
from understudy_motion.origin import provenance
from understudy_motion.readers.text import decoded
from understudy_motion.reading import UNSAID, ClipReader, ReadOptions
from understudy_tensors import rotations

JOINTS: tuple[tuple[str, int], ...] = (
    ("root", 4),
    ("chest", 4),
    ("neck", 4),
    ("right_hip", 4),
    ("right_knee", 1),
    ("right_ankle", 4),
    ("right_shoulder", 4),
    ("right_elbow", 1),
    ("left_hip", 4),
    ("left_knee", 1),
    ("left_ankle", 4),
    ("left_shoulder", 4),
    ("left_elbow", 1),
)
"""Names and how many numbers each takes in a row."""

OFFSETS: Mapping[str, tuple[str, tuple[float, float, float]]] = {
    "chest": ("root", (0.0, 0.0, 0.236)),
    "neck": ("chest", (0.0, 0.0, 0.224)),
    "right_hip": ("root", (0.0, -0.085, 0.0)),
    "right_knee": ("right_hip", (0.0, 0.0, -0.422)),
    "right_ankle": ("right_knee", (0.0, 0.0, -0.41)),
    "right_shoulder": ("chest", (-0.024, -0.183, 0.2435)),
    "right_elbow": ("right_shoulder", (0.0, 0.0, -0.275)),
    "left_hip": ("root", (0.0, 0.085, 0.0)),
    "left_knee": ("left_hip", (0.0, 0.0, -0.422)),
    "left_ankle": ("left_knee", (0.0, 0.0, -0.41)),
    "left_shoulder": ("chest", (-0.024, 0.183, 0.2435)),
    "left_elbow": ("left_shoulder", (0.0, 0.0, -0.275)),
}
"""Each joint's parent and where it is in the parent's frame, m, z up: the humanoid of the release."""

SLOWEST = 3.0
"""s that most frames last at most: more are milliseconds of a slow recording."""

TIPS: Mapping[str, tuple[float, float, float]] = {
    "neck": (0.0, 0.0, 0.28),
    "right_elbow": (0.0, 0.0, -0.259),
    "left_elbow": (0.0, 0.0, -0.259),
    "right_ankle": (0.13, 0.0, -0.05),
    "left_ankle": (0.13, 0.0, -0.05),
}
"""Crown, wrists and toes, as in :data:`OFFSETS`."""

COLUMNS = 1 + 3 + sum(width for _, width in JOINTS)
MAX_BYTES = 16 * 2**20
MAX_FRAMES = 100_000
LOOPS = {"wrap": True, "none": False}


class DeepMimicReader(ClipReader):
    """Reads DeepMimic's JSON."""

    fixed = MappingProxyType(
        {"unit": "m", "up": "y", "rate": None, "skeleton": None, "angles": None}
    )
    suffixes = (".txt", ".json")

    def recognises(self, head: bytes, path: Path) -> bool:
        is_object = head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{")
        return is_object and (b'"Frames"' in head or b'"Loop"' in head)

    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        content = read_bytes(path, MAX_BYTES)
        document = _document(path, content)
        said = document.get("Loop")
        loop = (
            said
            if isinstance(said, bool)
            else LOOPS.get(said.lower() if isinstance(said, str) else "")
        )
        loop = loop if options.loop is None else options.loop
        if loop is None:
            raise FileError(
                f'Clip {path}: \'Loop\' must be "wrap" or "none"; or say it by motion.loop=true or false.'
            )
        rows = _rows(path, document)
        durations = rows[:-1, 0]
        if len(durations) and (usual := float(np.median(durations))) > SLOWEST:
            raise FileError(
                f"Clip {path}: a frame lasts {usual:g} s, so durations seem to be in milliseconds; write them in seconds."
            )
        if not (durations > 0.0).all():
            frame = int(np.argmin(durations > 0.0))
            raise FileError(
                f"Clip {path}: frame {frame}: duration is {durations[frame]:g} s, must be above 0."
            )
        values = torch.from_numpy(rows)
        return Clip(
            name=path.stem,
            times=torch.cat((torch.zeros(1, dtype=values.dtype), values[:-1, 0].cumsum(dim=0))),
            root_position=torch.stack((values[:, 1], -values[:, 3], values[:, 2]), dim=-1),
            rotations=_rotations(values[:, 4:]),
            joint_names=tuple(name for name, _ in JOINTS),
            loop=loop,
            skeleton=_skeleton(),
            **provenance(path, content),
        )


def _skeleton() -> Skeleton:
    names = tuple(name for name, _ in JOINTS)
    return Skeleton(
        joint_names=names,
        parents=(-1, *(names.index(OFFSETS[name][0]) for name in names[1:])),
        offsets=np.array([(0.0, 0.0, 0.0), *(OFFSETS[name][1] for name in names[1:])]),
        tips={name: np.array(tip) for name, tip in TIPS.items()},
    )


def _document(path: Path, content: bytes) -> dict[str, Any]:
    def not_a_number(word: str) -> NoReturn:
        raise ValueError(f"{word} is not a number")

    try:
        document = json.loads(decoded(content), parse_constant=not_a_number)
    except RecursionError as error:
        raise FileError(f"Clip {path}: nested too deeply to be a clip.") from error
    except ValueError as error:
        raise FileError(f"Clip {path}: not valid JSON: {error}.") from error
    if not isinstance(document, dict):
        raise FileError(f"Clip {path}: not a clip: no 'Loop' and 'Frames' at the top level.")
    if "Frames" not in document:
        found = suggestion("Frames", document) if len(document) <= 20 else ""
        raise FileError(f"Clip {path}: not a clip: 'Frames' is missing.{found}")
    return document


def _rows(path: Path, document: dict[str, Any]) -> np.ndarray:
    """The frames as (F, 44) finite float64."""
    frames = document["Frames"]
    if not isinstance(frames, list):
        raise FileError(f"Clip {path}: 'Frames' is not a list.")
    if not 2 <= len(frames) <= MAX_FRAMES:
        raise FileError(
            f"Clip {path}: {len(frames)} frames; a clip has from 2 to {MAX_FRAMES} of them."
        )
    for index, row in enumerate(frames):
        if not isinstance(row, list) or len(row) != COLUMNS:
            size = f"{len(row)} numbers" if isinstance(row, list) else type(row).__name__
            raise FileError(
                f"Clip {path}: frame {index}: a row of {COLUMNS} numbers is needed, not {size}."
            )
        if not set(map(type, row)) <= {int, float}:
            column = next(i for i, value in enumerate(row) if type(value) not in (int, float))
            raise FileError(f"Clip {path}: frame {index}: {_field(column)} is not a number.")
    try:
        rows = np.array(frames, dtype=np.float64)
    except OverflowError as error:
        raise FileError(f"Clip {path}: a number in 'Frames' is too large.") from error
    finite = np.isfinite(rows)
    if not finite.all():
        index, column = np.argwhere(~finite)[0]
        raise FileError(f"Clip {path}: frame {index}: {_field(column)} is not finite.")
    return rows


def _field(column: int) -> str:
    """What a column of a row holds, in words."""
    if column == 0:
        return "duration"
    if column < 4:
        return f"root position {'xyz'[column - 1]}"
    start = 4
    for name, width in JOINTS:
        if column < start + width:
            part = "angle" if width == 1 else f"quaternion {'wxyz'[column - start]}"
            return f"{name} {part}"
        start += width
    raise IndexError(column)


def _rotations(columns: torch.Tensor) -> torch.Tensor:
    """(F, 40) of the file -> (F, 13, 4) in z-up frames."""
    hinge_axis = torch.tensor([0.0, -1.0, 0.0], dtype=columns.dtype)
    joints = []
    for values in columns.split([width for _, width in JOINTS], dim=-1):
        if values.shape[-1] == 1:
            joints.append(rotations.from_axis_angle(hinge_axis, values[:, 0]))
        else:
            w, x, y, z = values.unbind(dim=-1)
            joints.append(torch.stack((w, x, -z, y), dim=-1))
    return torch.stack(joints, dim=1)
