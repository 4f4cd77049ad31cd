"""From the frames and Euler angles of motion files to the world's frame and quaternions."""

from __future__ import annotations

from functools import reduce

import numpy as np
import torch
from torch import Tensor

from understudy_motion.reading import Axis
from understudy_tensors import rotations


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
