"""Points on a character's surface."""

from __future__ import annotations

from functools import lru_cache

import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.shapes import shapes


@lru_cache(maxsize=8)  # each look at a clip asks for it anew
def surface_points(character: Character) -> tuple[np.ndarray, Tensor]:
    """Of each geom the vertices that are outermost in 26 directions: the joint's row (P,), and the
    place in the joint's frame (P, 3)."""
    grid = np.array(np.meshgrid(*[[-1, 0, 1]] * 3)).reshape(3, -1).T
    directions = grid[np.abs(grid).sum(1) > 0]
    owners, points = [], []
    for shape in shapes(character):
        chosen = shape.vertices[np.unique((shape.vertices @ directions.T).argmax(0))]
        owners += [character.joint_names.index(shape.joint)] * len(chosen)
        points.append(chosen)
    return np.array(owners), torch.from_numpy(np.concatenate(points))
