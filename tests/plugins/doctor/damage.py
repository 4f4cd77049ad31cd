"""Damage to clips, one defect each, at known places and of known sizes."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import torch
from torch import Tensor

from understudy_motion.clip import Clip, sample
from understudy_motion.editing import reach, shift
from understudy_tensors import rotations


def walking(clip: Clip, cycles: int = 3) -> Clip:
    """Some cycles of a looping clip, at its frames, as a clip that does not loop."""
    steps = clip.num_frames - 1
    times = torch.arange(cycles * steps + 1, dtype=torch.float64) * (clip.duration / steps)
    position, rotation = sample(clip, times)
    return replace(clip, times=times, root_position=position, rotations=rotation, loop=False)


def bump(clip: Clip, start: float, stop: float) -> Tensor:
    """(F,) from 0 at `start` s up to 1 and back to 0 at `stop` s, smooth in velocity."""
    t = ((clip.times - start) / (stop - start)).clamp(0.0, 1.0)
    return 0.5 * (1.0 - torch.cos(2.0 * torch.pi * t))


def raised(clip: Clip, height: Tensor | float) -> Clip:
    """By `height` m, a number or (F,)."""
    offset = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    offset[:, 2] = height
    return shift(clip, offset)


def turned(clip: Clip, joint: str, axis: Sequence[float], angle: Tensor) -> Clip:
    """The joint turned further by `angle` (F,) rad about `axis`, in its own frame."""
    row = clip.joint_names.index(joint)
    turn = rotations.from_axis_angle(torch.tensor(axis, dtype=torch.float64), angle)
    result = clip.rotations.clone()
    result[:, row] = rotations.multiply(result[:, row], turn)
    return replace(clip, rotations=result)


def between(clip: Clip, first: int, last: int) -> Tensor:
    """(F,) 1 in these frames, 0 elsewhere."""
    frames = torch.arange(clip.num_frames)
    return ((frames >= first) & (frames <= last)).to(torch.float64)


def slid(clip: Clip, foot: str, distance: float, start: float, stop: float, back: float) -> Clip:
    """The foot slides ahead by `distance` m from `start` to `stop` s and is back at `back` s."""
    t = clip.times
    out = ((t - start) / (stop - start)).clamp(0.0, 1.0)
    home = ((t - stop) / (back - stop)).clamp(0.0, 1.0)
    path = torch.zeros(clip.num_frames, 3, dtype=torch.float64)
    path[:, 0] = distance * (_ease(out) - _ease(home))
    return reach(clip, foot, path, (0.0, 1.0, 0.0))


def _ease(u: Tensor) -> Tensor:
    return u**2 * (3.0 - 2.0 * u)


def frozen(clip: Clip, first: int, last: int) -> Clip:
    """Frames `first` to `last` repeat the one before."""
    position, rotation = clip.root_position.clone(), clip.rotations.clone()
    position[first : last + 1] = position[first - 1]
    rotation[first : last + 1] = rotation[first - 1]
    return replace(clip, root_position=position, rotations=rotation)


def held(clip: Clip, first: int, last: int) -> Clip:
    """The root stays in frames `first` to `last` where it was before; the joints go on."""
    position = clip.root_position.clone()
    position[first : last + 1] = position[first - 1]
    return replace(clip, root_position=position)


def paused(clip: Clip, frame: int, count: int) -> Clip:
    """`count` copies of a frame are put in after it, and take their time."""
    index = torch.arange(clip.num_frames)
    index = torch.cat((index[: frame + 1], index[frame].repeat(count), index[frame + 1 :]))
    dt = clip.times[1].item()
    times = torch.arange(len(index), dtype=torch.float64) * dt
    return replace(
        clip,
        times=times,
        root_position=clip.root_position[index],
        rotations=clip.rotations[index],
    )
