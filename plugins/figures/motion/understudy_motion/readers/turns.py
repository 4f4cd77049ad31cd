"""Rotations of joints as networks and body models give them: vectors, matrices, halves of matrices, quaternions.

What the numbers are is told by how many there are a joint: 3 of a rotation vector, 9 of a matrix, 4 of a quaternion,
6 of two columns of a matrix (Zhou et al., CVPR 2019), one after the other or side by side, or of two of its rows, as
PyTorch3D has them.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from understudy.errors import FileError

_TAILS = ((), (3,), (3, 3), (9,), (6,), (3, 2), (2, 3), (4,))
"""The axes of one joint's numbers."""
_LOOSE = 0.1
"""What a matrix of a rotation may be from one."""
_NETWORK = 0.5
"""What halves of matrices and quaternions may be from unit length, as networks give them."""


def layout(shape: Sequence[int], joints: Collection[int]) -> tuple[int, int, int] | None:
    """Frames, joints and numbers a joint of an array of rotations; None if it is none of so many `joints`.

    Axes of one, as of a batch, count for nothing.
    """
    several = [size for size in shape if size != 1]
    for frames, *rest in ([several] if several else []) + [[1, *several]]:
        total = math.prod(rest)
        for size in (3, 9, 6, 4):
            count = total // size
            apart = rest[1:] if count > 1 and rest[:1] == [count] else rest
            known = tuple(apart) in _TAILS and math.prod(apart) == size
            if total == count * size and count in joints and (known or rest == [total]):
                return frames, count, size
    return None


def vectors(path: Path, name: str, values: np.ndarray, first: bool) -> np.ndarray:
    """Rotation vectors (F, J, 3) of an array (F, J, 3), (F, J, 9), (F, J, 6) or (F, J, 4).

    `first` is that four numbers have the real part first, not last, and that six one after the other are rows of
    the matrix, not columns.

    Raises
    ------
    FileError
        names the frame of the first one that is no rotation.
    """
    size = values.shape[2]
    if size == 3 or not values.size:
        return values[..., :3]
    if size == 4:
        length = np.linalg.norm(values, axis=2)
        _refuse(path, name, "quaternion", np.abs(length - 1.0) > _NETWORK)
        ordered = values[..., [1, 2, 3, 0]] if first else values
        turns = Rotation.from_quat(ordered.reshape(-1, 4))
        return turns.as_rotvec().reshape(*values.shape[:2], 3)
    matrices = (
        values.reshape(*values.shape[:2], 3, 3) if size == 9 else _whole(path, name, values, first)
    )
    apart = np.abs(matrices @ matrices.swapaxes(2, 3) - np.eye(3)).max(axis=(2, 3))
    _refuse(path, name, "matrix", (apart > _LOOSE) | (np.linalg.det(matrices) < 0.0))
    turns = Rotation.from_matrix(matrices.reshape(-1, 3, 3))
    return turns.as_rotvec().reshape(*values.shape[:2], 3)


def _whole(path: Path, name: str, values: np.ndarray, rows: bool) -> np.ndarray:
    """Matrices (F, J, 3, 3) of halves (F, J, 6), made orthonormal as networks' are meant to be."""
    after = values.reshape(*values.shape[:2], 2, 3)
    beside = values.reshape(*values.shape[:2], 3, 2).swapaxes(2, 3)
    wrong = [
        np.abs(half @ half.swapaxes(2, 3) - np.eye(2)).max(axis=(2, 3)) for half in (after, beside)
    ]
    side_by_side = np.median(wrong[1]) < np.median(wrong[0])
    _refuse(path, name, "pair of a matrix' columns", wrong[int(side_by_side)] > _NETWORK)
    first, second = np.moveaxis(beside if side_by_side else after, 2, 0)
    first = first / np.linalg.norm(first, axis=2, keepdims=True)
    second = second - (first * second).sum(axis=2, keepdims=True) * first
    second = second / np.linalg.norm(second, axis=2, keepdims=True)
    matrices = np.stack((first, second, np.cross(first, second)), axis=2)
    return matrices if rows and not side_by_side else matrices.swapaxes(2, 3)


def _refuse(path: Path, name: str, what: str, wrong: np.ndarray) -> None:
    """Raise FileError if any (F, J) is `wrong`."""
    if wrong.any():
        raise FileError(
            f"Clip {path}: frame {int(wrong.any(axis=1).argmax())}: array '{name}' holds a {what} that is no rotation."
        )
