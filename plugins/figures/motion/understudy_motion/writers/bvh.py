"""Writes BVH: y up, z forward, centimetres, degrees; rotations as Z, X, Y.

The format has evenly spaced frames, so a clip of other times is resampled at its mean rate. It has
no place for the loop and the licence.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch
from scipy.spatial.transform import Rotation
from torch import Tensor

from understudy.errors import FileError
from understudy_motion.clip import Clip, Skeleton, resample
from understudy_motion.kinematics import need_skeleton
from understudy_motion.writing import ClipWriter, Shape

CENTIMETRES = 100.0


class BvhWriter(ClipWriter):
    """Writes BVH."""

    suffix = ".bvh"

    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        skeleton = need_skeleton(clip)
        for name in clip.joint_names:
            if name.split() != [name] or "{" in name or "}" in name:
                raise FileError(
                    f"Clip {clip.source}: joint '{name}' cannot be written as BVH: names there have "
                    "no blanks and no braces."
                )
        even = _evenly_timed(clip)
        order = _depth_first(skeleton.parents)
        angles = _euler_angles(even.rotations[:, order])
        rows = np.concatenate(
            (
                CENTIMETRES * _to_file(even.root_position.numpy()),
                angles.reshape(even.num_frames, -1),
            ),
            axis=1,
        )
        with path.open("w", encoding="utf-8", newline="\n") as file:
            file.write("\n".join(("HIERARCHY", *_hierarchy(skeleton, order), "MOTION", "")))
            file.write(f"Frames: {even.num_frames}\nFrame Time: {1.0 / even.frame_rate:.12g}\n")
            np.savetxt(file, rows, fmt="%.9f")


def _evenly_timed(clip: Clip) -> Clip:
    """The clip itself if its frames are even to a microsecond, else resampled at its mean rate."""
    even = torch.linspace(0.0, clip.duration, clip.num_frames, dtype=torch.float64)
    return clip if (clip.times - even).abs().max() < 1e-6 else resample(clip, clip.frame_rate)


def _depth_first(parents: Sequence[int]) -> list[int]:
    """All joints, each followed by what hangs on it."""
    children: list[list[int]] = [[] for _ in parents]
    for joint, parent in enumerate(parents[1:], start=1):
        children[parent].append(joint)
    order: list[int] = []
    waiting = [0]
    while waiting:
        order.append(waiting.pop())
        waiting.extend(reversed(children[order[-1]]))
    return order


def _hierarchy(skeleton: Skeleton, order: Sequence[int]) -> Iterator[str]:
    """The lines between HIERARCHY and MOTION."""
    depths: list[int] = []
    for parent in skeleton.parents:
        depths.append(0 if parent < 0 else depths[parent] + 1)
    for joint, follower in zip(order, (*order[1:], None), strict=True):
        name, depth = skeleton.joint_names[joint], depths[joint]
        margin, inside = "  " * depth, "  " * (depth + 1)
        positions = "Xposition Yposition Zposition " if depth == 0 else ""
        yield f"{margin}{'ROOT' if depth == 0 else 'JOINT'} {name}"
        yield f"{margin}{{"
        yield f"{inside}OFFSET {_vector(skeleton.offsets[joint])}"
        yield f"{inside}CHANNELS {6 if positions else 3} {positions}Zrotation Xrotation Yrotation"
        next_depth = 0 if follower is None else depths[follower]
        if name in skeleton.tips or next_depth <= depth:  # every last joint must end somewhere
            yield f"{inside}End Site"
            yield f"{inside}{{"
            yield f"{inside}  OFFSET {_vector(skeleton.tips.get(name, np.zeros(3)))}"
            yield f"{inside}}}"
        for closing in range(depth, next_depth - 1, -1):
            yield "  " * closing + "}"


def _vector(metres: np.ndarray) -> str:
    return " ".join(f"{value:.9f}" for value in CENTIMETRES * _to_file(np.asarray(metres)))


def _to_file(vectors: np.ndarray) -> np.ndarray:
    """Vectors (..., 3) with z up, x forward -> y up, z forward."""
    return vectors[..., [1, 2, 0]]


def _euler_angles(rotation: Tensor) -> np.ndarray:
    """(F, J, 4) with z up -> (F, J, 3) degrees about the file's z, x, y; the y turn is applied first."""
    w, x, y, z = rotation.reshape(-1, 4).numpy().T
    with warnings.catch_warnings():
        # At gimbal lock one of two equivalent turns is set to zero: still the same rotation.
        warnings.filterwarnings("ignore", message="Gimbal lock")
        angles = Rotation.from_quat(np.stack((y, z, x, w), axis=-1)).as_euler("ZXY", degrees=True)
    return angles.reshape(*rotation.shape[:2], 3)
