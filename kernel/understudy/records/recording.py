"""The recorded motion of one world of an evaluation, for those who draw or export it."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from understudy.records.checkpoint import write_atomically

if TYPE_CHECKING:
    from understudy.task.interfaces import Scene


@dataclass(frozen=True)
class Recording:
    """T frames of one world: the fields that its scene wants recorded."""

    tracks: Mapping[str, np.ndarray]  #: each (T, …); empty if the scene wants none
    control_dt: float  #: s between frames
    first_episode: int  #: frames before the world's first ending
    scene: Scene  #: what was recorded, which can draw it

    def save(self, path: Path) -> None:
        """Write the tracks, ``control_dt`` and ``first_episode`` as the npz file `path`.

        Raises
        ------
        RunError
            if the file cannot be written; the old one is untouched.
        """
        arrays: dict[str, Any] = {
            "control_dt": self.control_dt,
            "first_episode": self.first_episode,
            **self.tracks,
        }
        file = io.BytesIO()
        np.savez(file, **arrays)
        write_atomically(path, file.getvalue())
