"""References of low quality, as an animator's first key frames are (thesis, section 3.5.2)."""

from __future__ import annotations

from dataclasses import replace

import torch

from understudy.errors import ConfigError
from understudy.setup.plugins import installed
from understudy_motion import library
from understudy_motion.clip import Clip, sample


def keyframed(*, of: str = "humanoid3d_jog", keys: int = 5) -> Clip:
    """`keys` poses of the clip `of`, evenly spaced, the first and the last among them; what is between
    is interpolated, so limbs move at constant speeds and stop and turn at once.

    Raises:
        ConfigError: fewer than two keys, or a clip of key frames of itself.
        FileError: there is no clip of this name.
    """
    if keys < 2:
        raise ConfigError(f"motion.parameters.keys={keys} is not possible: at least 2.")
    if of == "keyframed":
        raise ConfigError("motion.parameters.of=keyframed is not possible: name another clip.")
    clip = library.load(of, None, installed().registry)
    times = torch.linspace(0.0, clip.duration, keys, dtype=torch.float64)
    position, rotation = sample(clip, times.clamp(max=clip.duration - 1e-9))
    return replace(
        clip,
        name=f"{clip.name}-{keys}-keys",
        times=times,
        root_position=position,
        rotations=rotation,
    )
