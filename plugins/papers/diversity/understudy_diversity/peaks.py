"""A strategy to look at: its film, the moment at its peak, and the pose there."""

from __future__ import annotations

import os
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from understudy.errors import UnderstudyError
from understudy.folders import DOCUMENT, write_atomically
from understudy_diversity.strategies import GalleryOptions
from understudy_report.pictures import png
from understudy_report.recording import recorded_tracks
from understudy_report.video import write_video
from understudy_sweeps.film import scene_of

#: Pixels of a film, and how slow it is: a jump lasts a second.
_WIDTH, _HEIGHT, _SLOWER = 480, 360, 3.0


@dataclass(frozen=True)
class Take:
    """What was drawn of a run; ``reason`` says why there is no film."""

    film: Path | None
    still: Path | None
    outline: np.ndarray | None  #: (S, 2, 3) m, line segments at the peak
    reason: str = ""


def take_of(run: Path, folder: Path, name: str, options: GalleryOptions) -> Take:
    """Draw the first recorded episode of `run` into `folder`, unless that was done before."""
    try:
        tracks, dt, length = recorded_tracks(run / "recording.npz")
    except UnderstudyError:
        return Take(None, None, None, "Nothing was recorded of it.")
    tracks = {k: v[:length] for k, v in tracks.items()}
    try:
        peak = peak_of(tracks, options)
    except LookupError as error:
        return Take(None, None, None, str(error))
    try:
        film, still = folder / f"{name}.mp4", folder / f"{name}-{peak}.png"
        scene = scene_of(run)
        outlines, _ = scene.outlines({k: v[peak : peak + 1] for k, v in tracks.items()})
        outline = None if outlines is None else outlines[0]
    except UnderstudyError as error:
        return Take(None, None, None, str(error))
    except Exception as error:  # a scene may come from any plugin
        return Take(None, None, None, f"It cannot be drawn: {error}")
    made = (run / "recording.npz").stat().st_mtime_ns
    ours = all(f.is_file() and f.stat().st_size <= DOCUMENT for f in (film, still))
    if ours and film.stat().st_mtime_ns == made:
        return Take(film, still, outline)
    every = round(np.clip(1.0 / (30.0 * _SLOWER * dt), 1, length))
    shown = np.arange(0, length, every)
    shown[np.abs(shown - peak).argmin()] = peak

    def frames() -> Iterator[np.ndarray]:
        drawn = scene.draw({k: v[shown] for k, v in tracks.items()}, _WIDTH, _HEIGHT)
        for at, frame in zip(shown, drawn, strict=False):
            if at == peak:
                write_atomically(still, png(frame))
            yield frame

    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_video(film, frames(), 1.0 / (every * dt * _SLOWER))
        os.utime(film, ns=(made, made))  # of which recording it is, whatever clocks say
    except Exception as error:  # a scene may come from any plugin
        return Take(None, None, outline, f"It cannot be drawn: {error}")
    return Take(film, still if still.exists() else None, outline)


def peak_of(tracks: dict[str, np.ndarray], options: GalleryOptions) -> int:
    """The frame of the peak.

    Raises
    ------
    LookupError
        if the recording has no such field, or the field no such number.
    """
    length = len(next(iter(tracks.values())))
    if options.track is None:
        return length // 2
    if options.track not in tracks:
        raise LookupError(f"gallery.track={options.track} was not recorded.")
    values = tracks[options.track].reshape(length, -1)
    if options.index >= values.shape[1]:
        raise LookupError(f"gallery.index={options.index}: {options.track} has no such number.")
    chosen = values[:, options.index]
    return int(chosen.argmax() if options.at is None else np.abs(chosen - options.at).argmin())


def figure(outline: np.ndarray | None, elevation: float) -> str:
    """An ``<svg>`` of the segments `outline` (S, 2, 3), seen from the right at `elevation` in degrees."""
    if outline is None:
        return ""
    turn, tilt = np.deg2rad(-75.0), np.deg2rad(elevation)
    to = np.array([np.cos(tilt) * np.cos(turn), np.cos(tilt) * np.sin(turn), np.sin(tilt)])
    right = np.cross([0.0, 0.0, 1.0], to)
    right /= np.linalg.norm(right)
    points = (outline - outline.reshape(-1, 3).mean(0)) @ np.stack(
        [right, np.cross(to, right), to]
    ).T
    depth = points[..., 2].mean(1)
    reach = max(0.2, float(np.abs(points[..., 2]).max()))
    parts = []
    for row in np.argsort(depth):
        (x, y, _), (u, v, _) = 100 * points[row]
        shade = 0.7 + 0.3 * float(depth[row] / reach)
        line = f"M{x:.1f} {-y:.1f}L{u:.1f} {-v:.1f}"
        parts.append(f'<path class="rim" d="{line}"/><path d="{line}" opacity="{shade:.2f}"/>')
    return (
        '<svg class="pose" viewBox="-105 -95 210 190" role="img" aria-label="pose at the peak" '
        f'xmlns="http://www.w3.org/2000/svg">{"".join(parts)}</svg>'
    )
