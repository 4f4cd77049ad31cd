"""The motion of one world of an evaluation, for pictures and exports."""

from __future__ import annotations

import io
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from understudy.folders import write_atomically
from understudy.task import Scene

__all__ = ["Recording"]


@dataclass(frozen=True)
class Recording:
    """Fields of one world, step by step."""

    tracks: Mapping[str, np.ndarray]  #: by field, each (T, …); empty if the scene records none
    control_dt: float  #: seconds between frames
    first_episode: int  #: frames of the world's first episode
    scene: Scene

    def save(self, path: Path) -> None:
        """Write it as a NumPy archive of plain arrays."""
        tracks: dict[str, Any] = dict(self.tracks)
        file = io.BytesIO()
        np.savez(file, control_dt=self.control_dt, first_episode=self.first_episode, **tracks)
        write_atomically(path, file.getvalue())
