"""How far human joints go, for ball joints, which a model lets go anywhere.

Normal ranges of motion: American Academy of Orthopaedic Surgeons, "Joint Motion: Method of Measuring
and Recording", 1965, as tabulated in Norkin and White, "Measurement of Joint Motion: A Guide to
Goniometry", 2009. They are of an average adult's single movements, so they are taken as an ellipse
with a margin, for what the athletic do and markers add.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import torch
from torch import Tensor

from understudy_characters.character import Character
from understudy_tensors import rotations

MARGIN = np.radians(20.0)
"""Beyond the ranges: the difference between an average and a supple adult, and of markers on skin."""


@dataclass(frozen=True)
class Range:
    """Degrees from the zero pose, which stands upright with hanging arms, looking along x.

    Swing is the turn of the limb's long axis, named by where the axis's end goes; twist is the turn
    about it.
    """

    words: tuple[str, ...]  #: one of them is part of the joint's name
    axis: tuple[float, float, float]  #: the long axis in the zero pose
    forward: float
    backward: float
    outward: float  #: away from the body's middle
    inward: float
    twist: float  #: to either side


_DOWN, _UP = (0.0, 0.0, -1.0), (0.0, 0.0, 1.0)
RANGES = (
    Range(("hip", "thigh", "upleg"), _DOWN, 120, 30, 45, 30, 45),
    Range(("shoulder", "upperarm", "uparm"), _DOWN, 180, 60, 180, 50, 90),
    Range(("ankle", "foot"), _DOWN, 20, 50, 15, 35, 35),
    Range(("chest", "spine", "torso", "waist"), _UP, 80, 25, 35, 35, 45),
    Range(("neck", "head"), _UP, 45, 45, 45, 45, 60),
)
_ALIGNED = np.cos(
    np.radians(40.0)
)  # a limb farther from the table's axis in the zero pose: no entry


def range_of(character: Character, row: int) -> Range | None:
    """The table's entry for a joint, by its name; None where there is none, or where the zero pose
    holds the limb elsewhere than the table takes it from (a T-pose)."""
    name = character.joint_names[row].lower()
    entry = next((r for r in RANGES if any(word in name for word in r.words)), None)
    if entry is None:
        return None
    skeleton = character.skeleton
    children = [j for j, parent in enumerate(skeleton.parents) if parent == row]
    limb = skeleton.offsets[children or [row]].mean(0)
    along = float(limb @ np.array(entry.axis))
    return entry if along >= _ALIGNED * float(np.linalg.norm(limb)) else None


def beyond(character: Character, row: int, local: Tensor, entry: Range) -> np.ndarray:
    """(F,) rad by which the rotations `local` (F, 4) of a joint go beyond its range, 0 within it."""
    axis = torch.tensor(entry.axis, dtype=torch.float64)
    twist = rotations.twist_angle(local, axis)
    back = rotations.from_axis_angle(axis, -twist)
    swing = rotations.to_exponential_map(rotations.multiply(local, back))
    end = torch.linalg.cross(swing, axis.expand_as(swing)).numpy()  # length: the angle
    side = np.sign(character.rest_positions[row][1]) or 1.0
    forward, outward = end[:, 0], side * end[:, 1]
    angle = np.hypot(forward, outward)
    # The same direction is reached by more than half a turn the other way: an arm held up and back.
    excess = np.minimum(
        angle - _most(entry, forward, outward),
        2.0 * np.pi - angle - _most(entry, -forward, -outward),
    )
    twisted = np.abs(twist.numpy()) - np.radians(entry.twist) - MARGIN
    # Twist loses its meaning towards a half turn of swing.
    twisted = np.where(angle < 0.5 * np.pi, twisted, 0.0)
    return np.maximum(np.maximum(excess, twisted), 0.0)


def _most(entry: Range, forward: np.ndarray, outward: np.ndarray) -> np.ndarray:
    """(F,) rad: how far the limb may swing in these directions, the radius of an ellipse."""
    angle = np.maximum(np.hypot(forward, outward), 1e-9)
    along = np.radians(np.where(forward > 0, entry.forward, entry.backward)) + MARGIN
    across = np.radians(np.where(outward > 0, entry.outward, entry.inward)) + MARGIN
    return angle / np.hypot(forward / along, outward / across).clip(1e-9)
