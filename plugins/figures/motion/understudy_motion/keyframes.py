"""Clips of low quality, as an animator's first key frames are (Ma et al. 2021; thesis, section 3.5.2)."""

from __future__ import annotations

from dataclasses import replace

import torch

from understudy_motion.clip import Clip, sample


def keyframed(clip: Clip, keys: int) -> Clip:
    """`keys` poses (2 at least) of `clip`, evenly spaced, the first and the last among them; what is
    between is interpolated, so limbs move at constant speeds and stop and turn at once."""
    times = torch.linspace(0.0, clip.duration, keys, dtype=torch.float64)
    position, rotation = sample(clip, times.clamp(max=clip.duration - 1e-9))
    return replace(
        clip,
        name=f"{clip.name}-{keys}-keys",
        times=times,
        root_position=position,
        rotations=rotation,
    )
