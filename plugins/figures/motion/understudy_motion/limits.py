"""What a clip's file may hold at most, and what is no skeleton: refused before it is held."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy_motion.clip import MAX_DISTANCE, Skeleton

__all__ = ["MAX_JOINTS", "MAX_ROTATIONS"]

MAX_BYTES = 256 * 2**20
MAX_JOINTS = 1000
MAX_NAME = 200
MAX_ROTATIONS = 8_000_000
"""Frames times joints: ten minutes of a hundred joints at 120 frames/s, 256 MB of quaternions."""


def read_bytes(
    path: Path, limit: int = MAX_BYTES, *, whole: bool = True, what: str = "Clip"
) -> bytes:
    """The content of the file, which is a `what`, at most `limit` bytes; more is an error if the `whole` file is wanted.

    Raises
    ------
    FileError
        missing, unreadable, or larger than `limit`.
    """
    try:
        if not path.is_file():
            raise FileError(f"{what} {path}: there is no such file.")
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, ValueError) as error:
        raise FileError(f"{what} {path}: cannot be read: {error}.") from error
    if whole and len(content) > limit:
        raise FileError(f"{what} {path}: larger than {limit // 2**20} MB.")
    return content[:limit]


def check_size(path: Path, frames: int, joint_names: Sequence[str]) -> None:
    """Refuse a clip too large to be held, before it is.

    Raises
    ------
    FileError
        more than :data:`MAX_JOINTS` or :data:`MAX_ROTATIONS`, or a joint's name of more
        than :data:`MAX_NAME` characters.
    """
    check_counts(path, frames, len(joint_names))
    if max(map(len, joint_names), default=0) > MAX_NAME:
        raise FileError(f"Clip {path}: a joint's name has more than {MAX_NAME} characters.")


def check_counts(path: Path, frames: int, joints: int) -> None:
    """:func:`check_size` of so many `joints`, before they are named."""
    if joints > MAX_JOINTS:
        raise FileError(f"Clip {path}: {joints} joints; at most {MAX_JOINTS} are read.")
    if frames * joints > MAX_ROTATIONS:
        raise FileError(
            f"Clip {path}: {frames} frames of {joints} joints are too many; cut it, or take every "
            f"second frame (at most {MAX_ROTATIONS} rotations are read)."
        )


def checked_skeleton(
    path: Path,
    joint_names: Sequence[str],
    parents: Sequence[int],
    offsets: np.ndarray,
    tips: Mapping[str, np.ndarray],
) -> Skeleton:
    """The :class:`Skeleton` of these fields, its root's offset set to zero.

    Raises
    ------
    FileError
        the parents are not a tree with joint 0 as its root, or a length is not finite
        or beyond :data:`MAX_DISTANCE`; names the joint.
    """
    for joint, (name, parent) in enumerate(zip(joint_names, parents, strict=True)):
        if not (parent == -1 if joint == 0 else 0 <= parent < joint):
            raise FileError(
                f"Clip {path}: joint '{name}': its parent must come before it, and only the first "
                "joint has none."
            )
    lengths = {name: offset for name, offset in zip(joint_names, offsets, strict=True)}
    for name, length in (*lengths.items(), *tips.items()):
        if name not in lengths:
            raise FileError(f"Clip {path}: a tip belongs to '{name}', which is no joint.")
        if not (np.abs(length) <= MAX_DISTANCE).all():
            raise FileError(
                f"Clip {path}: joint '{name}': an offset is not a number of metres up to "
                f"{MAX_DISTANCE:g}."
            )
    rooted = np.array(offsets, dtype=np.float64)
    rooted[0] = 0.0
    return Skeleton(tuple(joint_names), tuple(parents), rooted, dict(tips))
