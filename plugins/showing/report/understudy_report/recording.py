"""What an evaluation recorded of one world, read again."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy_motion.readers.npz import Archive

__all__ = ["recorded_tracks"]


def recorded_tracks(file: Path) -> tuple[dict[str, np.ndarray], float, int]:
    """Of a recording: the fields, each (T, …); s between frames; and how many frames, one at least, the
    first episode has.

    Raises
    ------
    FileError
        if it is missing, damaged, empty, or larger than a clip may be.
    """
    archive = Archive(file)
    dt, first = archive.number("control_dt"), archive.number("first_episode")
    names = sorted(archive.names - {"control_dt", "first_episode"})
    tracks = {name: archive.numbers(name) for name in names}
    lengths = {track.shape[:1] for track in tracks.values()}
    if dt <= 0 or len(lengths) != 1 or lengths <= {(), (0,)}:
        raise FileError(f"{file}: its fields are not of one number of frames, 1 or more.")
    frames = len(next(iter(tracks.values())))
    return tracks, dt, int(np.clip(first, 1, frames))
