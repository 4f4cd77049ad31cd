"""When the feet of a moving character are on the ground, judged from the motion alone."""

from __future__ import annotations

import numpy as np
import torch
from scipy.spatial import ConvexHull
from torch import Tensor

from understudy_basics import rotations
from understudy_characters.character import Character
from understudy_characters.shapes import shapes
from understudy_motion.clip import Clip
from understudy_motion.kinematics import forward_kinematics

LOW, SLOW = 0.03, 0.4
"""m above the ground and m/s below which a point of a foot comes into contact."""
HIGH, FAST = 0.05, 0.8
"""m above the ground and m/s beyond which it loses contact; a foot slower than that but sliding is
still in contact, so that slips can be told."""
SAME_LEVEL = 0.02
"""m: how much higher than the lowest joint another one may be in the zero pose to be a foot too."""


def feet(character: Character) -> tuple[str, ...]:
    """Names of the joints that carry what is lowest in the zero pose, in the character's order."""
    standing = torch.tensor(character.model.qpos0, dtype=torch.float64)[None]
    height = character.clearance(standing)[0]
    low = height <= height.min() + SAME_LEVEL
    return tuple(name for name, is_low in zip(character.joint_names, low, strict=True) if is_low)


def foot_points(character: Character) -> dict[str, Tensor]:
    """By foot: the points (P, 3) m, in the joint's frame, of which one is always the foot's lowest."""
    carried: dict[str, list[np.ndarray]] = {name: [] for name in feet(character)}
    for shape in shapes(character, character.geoms):
        if shape.joint in carried:
            carried[shape.joint].append(shape.vertices)
    joined = {name: np.concatenate(parts) for name, parts in carried.items()}
    # "QJ": flat feet are no error.
    return {
        name: torch.from_numpy(points[ConvexHull(points, qhull_options="QJ").vertices])
        for name, points in joined.items()
    }


def foot_contacts(character: Character, clip: Clip, *, ground: float = 0.0) -> Tensor:
    """Whether each foot of :func:`feet` is in contact with the ground, (F, feet) bool.

    A foot is in contact while some point of it is near the ground and nearly at rest. The limits for
    coming into contact are tighter than those for staying in it, so that it does not flicker.

    Args:
        character: whose feet.
        clip: the motion, of the character's joints; a looping one is judged across its seam.
        ground: height of the ground, m.

    Raises:
        FileError: the clip lacks a joint of the character.
    """
    times, own_frames = _with_seams(clip)
    qpos = character.qpos(clip, times)
    positions, turns = forward_kinematics(character.clip(qpos, times - times[0], name=clip.name))
    columns = []
    for name, points in foot_points(character).items():
        joint = character.joint_names.index(name)
        begins = torch.zeros(len(times), dtype=torch.bool)
        holds = begins.clone()
        for point in points:  # one at a time: a foot may have hundreds, a clip many frames
            track = positions[:, joint] + rotations.rotate(turns[:, joint], point)
            height = track[:, 2] - ground
            (velocity,) = torch.gradient(track, spacing=(times,), dim=0)
            speed = torch.linalg.vector_norm(velocity, dim=1)
            begins |= (height < LOW) & (speed < SLOW)
            holds |= (height < HIGH) & (speed < FAST)
        columns.append(latched(begins, holds)[own_frames])
    return torch.stack(columns, dim=1)


def _with_seams(clip: Clip) -> tuple[Tensor, slice]:
    """Times of the clip's frames, between those of the cycles before and after if it loops, and which
    are its own."""
    if not clip.loop:
        return clip.times, slice(None)
    before, after = clip.times[:-1] - clip.duration, clip.times[1:] + clip.duration
    return torch.cat((before, clip.times, after)), slice(len(before), len(before) + clip.num_frames)


def latched(begins: Tensor, holds: Tensor) -> Tensor:
    """(F,) bool: true from a frame that `begins` for as long as it `holds`; what begins holds."""
    frames = torch.arange(len(begins))
    begun = torch.where(begins, frames, -1).cummax(dim=0).values
    ended = torch.where(holds, -1, frames).cummax(dim=0).values
    return begun > ended
