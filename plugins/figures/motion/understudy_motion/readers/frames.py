"""From the frames and Euler angles of motion files to the world's frame and quaternions."""

from __future__ import annotations

from functools import reduce
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.errors import FileError
from understudy_motion.reading import Axis
from understudy_tensors import rotations

_TURN, _FAR, _DAMAGED = 4.0 * np.pi, 50.0, 1e5
"""rad of a rotation vector, and m of the pelvis above the floor, beyond which the unit is another; and m that no
unit explains."""


def to_world(vectors: np.ndarray, up: Axis) -> np.ndarray:
    """Vectors (..., 3) of a file, in the frame with z up.

    Files with y up have z forward and x left, so (x, y, z) becomes (z, x, y). Files with z up are
    taken as they are. Either way it is a rotation, which keeps angles about the turned axes.
    """
    return vectors[..., [2, 0, 1]] if up == "y" else vectors


def product_of_turns(axes: np.ndarray, angles: np.ndarray) -> Tensor:
    """R(axes[0], angles[:, 0]) R(axes[1], angles[:, 1]) …, the last turn applied first.

    Parameters
    ----------
    axes
        (K, 3), unit, all in the frame that the product is given in.
    angles
        (F, K) rad.

    Returns
    -------
    Tensor
        Quaternions (F, 4) float64; no turn at all is the identity.
    """
    turns = rotations.from_axis_angle(torch.tensor(axes), torch.tensor(angles))
    identity = torch.tensor([1.0, 0.0, 0.0, 0.0], dtype=torch.float64).expand(len(angles), 4)
    return reduce(rotations.multiply, turns.unbind(dim=1)) if len(axes) else identity


def check_sizes(path: Path, vectors: np.ndarray, heights: np.ndarray | None) -> None:
    """Raise FileError where rotation vectors are no radians, or `heights` (F,), if they are to be m, are none."""
    with np.errstate(over="ignore"):  # of numbers that are damaged the length is infinite
        longest = float(np.linalg.norm(vectors, axis=2).max(initial=0.0))
    if longest > _TURN:
        raise FileError(
            f"Clip {path}: its rotation vectors are up to {longest:.0f} rad long, so they seem to be in degrees; "
            "write them in radians."
        )
    high = 0.0 if heights is None or not len(heights) else abs(float(np.median(heights)))
    if _FAR < high < _DAMAGED:
        raise FileError(
            f"Clip {path}: its pelvis is {high:.0f} m from the floor; give motion.unit (--unit), as "
            f"{'cm' if high < 300.0 else 'mm'}."
        )
