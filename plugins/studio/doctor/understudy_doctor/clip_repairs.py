"""Repairs that need no character: frames, spikes, the seam of a loop.

Each ``mend_…`` returns the repaired clip and what was done, in words.
"""

from __future__ import annotations

from dataclasses import replace

import torch

from understudy_doctor.clip_checks import duplicates, find_spikes, held
from understudy_motion.clip import Clip
from understudy_motion.editing import (
    BLEND_SECONDS,
    bridge,
    close_loop,
    evenly_spaced,
    remove_frames,
)
from understudy_tensors import rotations

JUMP_SECONDS = 0.16
"""s over which a jump is spread: 0.5 rad at 3 rad/s."""
SPIKE_PASSES = 3
"""A spike may hide another."""


def undamaged(clip: Clip) -> Clip:
    """The clip with its repeated frames and its spikes interpolated over, in the same time.

    They are findings of their own; what they do to contacts and forces need not be told again.
    """
    for first, last in duplicates(clip):
        for joint in clip.joint_names:
            clip = bridge(clip, joint, first, last)
    return mend_spikes(mend_held(clip)[0])[0]


def mend_held(clip: Clip) -> tuple[Clip, list[str]]:
    """Where its position was lost, the root moves steadily."""
    position, done = clip.root_position.clone(), []
    for first, last in held(clip):
        before, after = clip.times[[first - 1, last + 1]]
        share = (clip.times[first : last + 1] - before) / (after - before)
        position[first : last + 1] = torch.lerp(
            position[first - 1], position[last + 1], share[:, None]
        )
        done.append(f"moved the root steadily over frames {first}–{last}")
    return (replace(clip, root_position=position) if done else clip), done


def mend_frames(clip: Clip) -> tuple[Clip, list[str]]:
    """Repeated frames are interpolated over if the motion went on meanwhile, else taken out; then
    frames are evenly spaced."""
    done = []
    for first, last in reversed(duplicates(clip)):
        before = _step(clip, first - 1, first - 2) if first >= 2 else 0.0
        after = _step(clip, last, last + 1) if last + 1 < clip.num_frames else 0.0
        frozen = after > 1.5 * before
        clip = remove_frames(clip, range(first, last + 1), close_up=not frozen)
        how = "interpolated over" if frozen else "took out"
        done.append(f"{how} {last - first + 1} repeated frame(s) from frame {first}")
    even = evenly_spaced(clip)
    if even is not clip:
        done.append(f"took evenly spaced frames, {even.frame_rate:.4g} a second")
    return even, done


def _step(clip: Clip, a: int, b: int) -> float:
    """rad: the largest turn of a joint between two frames."""
    return float(rotations.angle_between(clip.rotations[a], clip.rotations[b]).max())


def mend_spikes(clip: Clip) -> tuple[Clip, list[str]]:
    """Dropouts are interpolated over; jumps are spread over :data:`JUMP_SECONDS`."""
    done = []
    around = max(1, round(0.5 * JUMP_SECONDS * clip.frame_rate))
    for _ in range(SPIKE_PASSES):
        found = find_spikes(clip)
        if not found:
            break
        for spike in found:
            first, last = spike.frames
            if spike.back is None:
                first, last = first + 1 - around, last - 1 + around
            first, last = max(first, 0), min(last, clip.num_frames - 1)
            joint = clip.joint_names[max(spike.row, 0)]
            clip = bridge(clip, joint, first, last)
            done.append(f"interpolated {joint} over frames {first}–{last}")
    return clip, list(dict.fromkeys(done))


def mend_seam(clip: Clip) -> tuple[Clip, list[str]]:
    """The loop is closed, in pose and in velocity."""
    blend = min(BLEND_SECONDS, 0.5 * clip.duration)
    return close_loop(clip), [f"closed the loop, blending {blend:.2f} s on either side of the seam"]
