"""The mirror image of a clip: what the left did, the right does."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import torch

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton

__all__ = ["mirrored"]

#: A rotation's image in the xz plane, by component: turns about x and z change their sense.
_IMAGE = torch.tensor([1.0, -1.0, 1.0, -1.0], dtype=torch.float64)
_SIDES = (("left", "right"), ("Left", "Right"), ("LEFT", "RIGHT"))


def mirrored(clip: Clip) -> Clip:
    """`clip` reflected in the world's xz plane, with the names of left and right joints exchanged.

    Joints are paired by ``left`` and ``right`` in their names, or by a first letter L and R that is
    all that tells two names apart (``lfemur``, ``rfemur``); others are their own images. All joints'
    frames are taken to be parallel to the root's in the zero pose, as in clips with z up. Twice
    mirrored, a clip is itself.

    Raises
    ------
    FileError
        a joint of one side has no counterpart, or hangs on another part of the figure.
    """
    pairs = _counterparts(clip)
    return replace(
        clip,
        root_position=clip.root_position * torch.tensor([1.0, -1.0, 1.0], dtype=torch.float64),
        rotations=clip.rotations[:, pairs] * _IMAGE,
        skeleton=None if clip.skeleton is None else _mirrored_skeleton(clip, clip.skeleton, pairs),
    )


def _counterparts(clip: Clip) -> list[int]:
    """For each joint, the row of the joint whose image it becomes."""
    names = clip.joint_names
    rows = {name: row for row, name in enumerate(names)}
    result = []
    for name in names:
        other = _other_side(name)
        if other is not None and other not in rows:
            raise FileError(
                f"Clip {clip.source}: joint '{name}' has no counterpart '{other}', "
                "without which the clip has no mirror image."
            )
        result.append(rows[other or _by_first_letter(name, names)])
    return result


def _other_side(name: str) -> str | None:
    """The name with left and right exchanged, if it has one of them."""
    for left, right in _SIDES:
        if left in name:
            return name.replace(left, right)
        if right in name:
            return name.replace(right, left)
    return None


def _by_first_letter(name: str, names: Sequence[str]) -> str:
    """The name that begins with the other of L and R and is the same otherwise, or `name`."""
    other = name[:1].translate(str.maketrans("lrLR", "rlRL")) + name[1:]
    return other if other in names else name


def _mirrored_skeleton(clip: Clip, skeleton: Skeleton, pairs: list[int]) -> Skeleton:
    image = np.array([1.0, -1.0, 1.0])
    names = skeleton.joint_names
    parents = [skeleton.parents[row] for row in pairs]
    for name, parent, wanted in zip(names, parents, skeleton.parents, strict=True):
        if (parent if parent < 0 else pairs[parent]) != wanted:
            raise FileError(
                f"Clip {clip.source}: joint '{name}' and its counterpart hang on different parts, "
                "so that the figure has no mirror image."
            )
    return replace(
        skeleton,
        offsets=skeleton.offsets[pairs] * image,
        tips={
            names[row]: skeleton.tips[names[pair]] * image
            for row, pair in enumerate(pairs)
            if names[pair] in skeleton.tips
        },
    )
