"""The feet of a character."""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
import torch
from scipy.spatial import ConvexHull
from torch import Tensor

from understudy_characters.character import Character
from understudy_characters.shapes import shapes

__all__ = ["feet", "foot_points", "latched"]

SAME_LEVEL = 0.02
"""m: how much higher than the lowest joint another one may be in the zero pose to be a foot too."""


def feet(character: Character) -> tuple[str, ...]:
    """Names of the joints that carry what is lowest in the zero pose, in the character's order."""
    standing = torch.tensor(character.model.qpos0, dtype=torch.float64)[None]
    height = character.clearance(standing)[0]
    low = height <= height.min() + SAME_LEVEL
    return tuple(name for name, is_low in zip(character.joint_names, low, strict=True) if is_low)


def foot_points(character: Character, joints: Collection[str] | None = None) -> dict[str, Tensor]:
    """By foot, or other one of these `joints`: the points (P, 3) m, in the joint's frame, of which one is always the lowest
    of what it carries; those that carry nothing are left out."""
    names = feet(character) if joints is None else joints
    carried: dict[str, list[np.ndarray]] = {name: [] for name in names}
    for shape in shapes(character, character.geoms):
        if shape.joint in carried:
            carried[shape.joint].append(shape.vertices)
    joined = {name: np.concatenate(parts) for name, parts in carried.items() if parts}
    # "QJ": flat feet are no error.
    return {
        name: torch.from_numpy(points[ConvexHull(points, qhull_options="QJ").vertices])
        for name, points in joined.items()
    }


def latched(begins: Tensor, holds: Tensor) -> Tensor:
    """(F,) bool: true from a frame that `begins` for as long as it `holds`; a frame that begins also holds."""
    frames = torch.arange(len(begins))
    begun = torch.where(begins, frames, -1).cummax(dim=0).values
    ended = torch.where(holds, -1, frames).cummax(dim=0).values
    return begun > ended
