"""The last evaluations of several runs side by side, in one video."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from understudy.errors import FileError, RunError, UnderstudyError
from understudy.folders import opened, read, write_atomically
from understudy.records import runs
from understudy.setup.building import build_scene
from understudy.task import Scene
from understudy_report.recording import recorded_tracks
from understudy_report.video import write_video

__all__ = ["scene_of"]

#: Of a tile, in pixels, by the number of columns: drawn without a GPU, a pixel costs time.
_WIDTHS = {1: 640, 2: 480, 3: 360}
_RATE = 30.0  #: frames a second, at most
_SECONDS = 20.0  #: at most
_EDGE = 120  #: the grey between tiles


@dataclass(frozen=True)
class Tile:
    """A run to show under a name."""

    name: str
    run: Path
    index: int = 0  #: of its variant

    @property
    def recording(self) -> Path:
        return self.run / "recording.npz"


def columns_of(count: int) -> int:
    """The number of columns for `count` tiles."""
    return 1 if count == 1 else 2 if count in (2, 4) else 3


def shows(path: Path, tiles: Sequence[Tile]) -> bool:
    """Whether the video `path` is of exactly these recordings; times of files are no evidence, since clocks are set."""
    mark = path.with_suffix(".json")
    try:
        with opened(path):  # as large as the page takes one
            return read(mark) == _identity(tiles)
    except OSError:
        return False


def make_film(path: Path, tiles: Sequence[Tile]) -> None:
    """Write the video `path` of the recordings of `tiles`, row by row; one that shows just these
    already stays.

    Raises
    ------
    UnderstudyError
        if there is nothing to draw, or nothing can be drawn here.
    """
    mark, note = path.with_suffix(".json"), _identity(tiles)
    if shows(path, tiles):
        return
    path.unlink(missing_ok=True)
    columns = columns_of(len(tiles))
    width = _WIDTHS[columns]
    size = width, width * 9 // 16 // 2 * 2
    takes = [_Take.load(tile) for tile in tiles]
    rate = min(_RATE, max(1.0 / take.dt for take in takes))
    seconds = min(_SECONDS, max(take.seconds for take in takes))
    sheets = [take.frames(rate, math.ceil(seconds * rate), *size) for take in takes]
    blank = np.zeros((size[1], size[0], 3), np.uint8)

    def frames() -> Iterator[np.ndarray]:
        for shown in zip(*sheets, strict=True):
            cells = [*shown, *[blank] * (-len(shown) % columns)]
            lines = [np.hstack(cells[i : i + columns]) for i in range(0, len(cells), columns)]
            sheet = np.vstack(lines)
            for edge in range(1, columns):
                sheet[:, edge * size[0] - 1 : edge * size[0] + 1] = _EDGE
            for edge in range(1, len(lines)):
                sheet[edge * size[1] - 1 : edge * size[1] + 1] = _EDGE
            yield sheet

    write_video(path, frames(), rate)
    write_atomically(mark, note)


def _identity(tiles: Sequence[Tile]) -> bytes:
    """Everything that the film's look depends on."""
    stamps = [
        (t.name, t.run.name, t.recording.stat().st_mtime_ns) for t in tiles if t.recording.exists()
    ]
    return json.dumps(stamps).encode()


@dataclass(frozen=True)
class _Take:
    """A recording and the scene that draws it."""

    scene: Scene
    tracks: dict[str, np.ndarray]  #: by field, each (T, …)
    dt: float  #: s

    @classmethod
    def load(cls, tile: Tile) -> _Take:
        if not tile.recording.exists():
            raise RunError(f"nothing was recorded of {tile.name}")
        try:
            tracks, dt, _ = recorded_tracks(tile.recording)
        except FileError as error:
            raise RunError(f"the recording of {tile.name} is damaged or empty") from error
        return cls(scene_of(tile.run), tracks, dt)

    @property
    def seconds(self) -> float:
        return len(next(iter(self.tracks.values()))) * self.dt

    def frames(self, rate: float, count: int, width: int, height: int) -> Iterator[np.ndarray]:
        """`count` frames, `rate` a second; the last one stays."""
        length = len(next(iter(self.tracks.values())))
        wanted = (np.arange(count) / rate / self.dt + 1e-6).astype(int)
        wanted = wanted[wanted < length]
        drawn = self.scene.draw({k: v[wanted] for k, v in self.tracks.items()}, width, height)
        frame = np.zeros((height, width, 3), np.uint8)
        left = count
        for frame in drawn:
            yield frame
            left -= 1
        for _ in range(left):
            yield frame


def scene_of(folder: Path) -> Scene:
    """The scene of the run in `folder`, on the CPU."""
    experiment = runs.open_run(folder).experiment()
    try:
        scene = build_scene(experiment).scene
    except UnderstudyError:
        raise
    except Exception as error:  # it may come from any plugin
        raise RunError(f"{type(error).__name__}: {error}") from error
    assert scene is not None
    return scene
