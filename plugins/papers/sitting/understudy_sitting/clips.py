"""Clips that no other plugin has: stepping back, and the whole of walking, turning and sitting down."""

from __future__ import annotations

import math
from dataclasses import replace

import torch

from understudy_humanoid.clips import generated_sit, generated_turn_left, generated_walk
from understudy_motion.clip import Clip, resample
from understudy_tensors import rotations


def generated_step_back(
    *,
    speed: float = 0.6,  #: m/s, speed backwards, up to 3
    cycle: float = 1.2,  #: s that two steps take, from 0.4 to 3
    frame_rate: float = 60.0,  #: frame rate of the clip, in frames/s, from 10 to 1000
) -> Clip:
    """One gait cycle backwards along -x: the generated walk in reverse.

    "Fig. 6 (row 5) shows a failure case where the humanoid needs a 'back up' move" (section 7).

    Parameters
    ----------
    speed, cycle, frame_rate
        as of the generated walk.

    Raises
    ------
    ConfigError
        as the generated walk does.
    """
    walk = generated_walk(speed=speed, cycle=cycle, frame_rate=frame_rate)
    place = walk.root_position.flip(0)
    start = place[:1] * torch.tensor([1.0, 1.0, 0.0], dtype=place.dtype)
    return replace(
        walk,
        name="step_back",
        times=walk.times[-1] - walk.times.flip(0),
        root_position=place - start,
        rotations=walk.rotations.flip(0),
    )


def generated_whole(
    *,
    seat_height: float = 0.45,  #: m, height of the seat above the floor, from 0.35 to 0.55
    frame_rate: float = 60.0,  #: frame rate of the clip, in frames/s, from 10 to 1000
) -> Clip:
    """Two steps ahead, half a turn to the left, and sitting down: the reference of the baselines that have
    no skills (section 7). Where one part passes into the next the pose is blended over 0.3 s.

    Raises
    ------
    ConfigError
        the seat's height or the frame rate is outside its range.
    """
    parts = (
        generated_walk(frame_rate=frame_rate),
        generated_turn_left(angle=math.pi, seconds=3.2, frame_rate=frame_rate),
        generated_sit(seat_height=seat_height, frame_rate=frame_rate),
    )
    whole = _joined([replace(resample(part, frame_rate), loop=False) for part in parts], frame_rate)
    return replace(whole, name="whole", loop=False)


def _joined(parts: list[Clip], frame_rate: float, seconds: float = 0.3) -> Clip:
    """The clips one after the other, each moved to where and turned to how the one before ended."""
    frames = round(seconds * frame_rate)
    place, turned = parts[0].root_position, parts[0].rotations
    for part in parts[1:]:
        turn = rotations.heading(turned[-1:, 0]) - rotations.heading(part.rotations[:1, 0])
        about = rotations.from_heading(turn)
        begin = part.root_position[:1] * torch.tensor([1.0, 1.0, 0.0], dtype=place.dtype)
        end = place[-1:] * torch.tensor([1.0, 1.0, 0.0], dtype=place.dtype)
        path = rotations.rotate(about, part.root_position - begin) + end
        pose = part.rotations.clone()
        pose[:, 0] = rotations.multiply(about, pose[:, 0])
        share = torch.linspace(0, 1, frames + 1, dtype=place.dtype)[:-1]
        share = share * share * (3 - 2 * share)
        lift = (place[-1:, 2:] - path[:1, 2:]) * (1 - share)[:, None]
        path[:frames, 2:] += lift
        last = turned[-1:].expand(frames, -1, -1)
        pose[:frames] = rotations.slerp(last, pose[:frames], share[:, None])
        place, turned = torch.cat([place, path[1:]]), torch.cat([turned, pose[1:]])
    times = torch.arange(len(place), dtype=place.dtype) / frame_rate
    return replace(parts[0], times=times, root_position=place, rotations=turned)
