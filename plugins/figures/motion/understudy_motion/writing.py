"""Writing a clip in any format: the destination's ending decides which writer writes it.

A writer is a component of kind ``clip_writer``, so that a plugin can add a format.
"""

from __future__ import annotations

import os
import tempfile
from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from understudy.errors import FileError
from understudy.setup.registry import Registry
from understudy_motion.clip import Clip
from understudy_motion.origin import without_folder
from understudy_motion.reading import every

__all__ = ["ClipWriter", "Shape", "Shown", "write_clip", "write_figures", "writer_of"]


@dataclass(frozen=True)
class Shape:
    """A rigid piece of the figure, fixed to one joint, for formats that show bodies."""

    joint: str
    vertices: np.ndarray  #: (V, 3) m, in the joint's frame
    faces: np.ndarray  #: (T, 3) rows of vertices, counter-clockwise seen from outside
    colour: tuple[float, float, float, float] = (0.8, 0.8, 0.8, 1.0)  #: linear RGBA


@dataclass(frozen=True)
class Shown:
    """A motion among others in one file."""

    clip: Clip
    shapes: Sequence[Shape] = ()  #: shown where the format can
    aside: float = 0.0  #: m to the left of where it moves


class ClipWriter(ABC):
    """Writes one format."""

    #: The ending of its files, with the dot.
    suffix: str

    @abstractmethod
    def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
        """Write `clip` to the new file `path`; `shapes` are shown where the format can.

        Raises
        ------
        FileError
            the format cannot hold this clip (it needs a skeleton, for instance).
        """

    def write_all(self, figures: Sequence[Shown], path: Path) -> None:
        """Write several motions to the new file `path`, the first of which says whence they are.

        Raises
        ------
        FileError
            the format holds one motion, or as :meth:`write`.
        """
        if len(figures) > 1:
            raise FileError(
                f"Clip {path}: '{self.suffix}' files hold one motion; write .glb or .gltf."
            )
        self.write(figures[0].clip, path, figures[0].shapes)


def write_clip(clip: Clip, path: Path, registry: Registry, shapes: Sequence[Shape] = ()) -> None:
    """:func:`write_figures` of one motion."""
    write_figures([Shown(clip, shapes)], path, registry)


def writer_of(path: Path, registry: Registry) -> ClipWriter:
    """The writer for the ending of `path`.

    Raises
    ------
    FileError
        there is none, or a run's own recording is there.
    """
    if path.name == "recording.npz" and (path.parent / "run.json").exists():
        raise FileError(
            f"Clip {path}: that is the run's own recording, which has more than a clip. Name another file."
        )
    writers: list[ClipWriter] = [*every(registry, "clip_writer", ClipWriter).values()]
    writer = next((w for w in writers if w.suffix == path.suffix.lower()), None)
    if writer is None:
        endings = ", ".join(sorted(w.suffix for w in writers))
        raise FileError(
            f"Clip {path}: no format is written to '{path.suffix}' files. Known: {endings}."
            f"{registry.absent()}"
        )
    return writer


def write_figures(figures: Sequence[Shown], path: Path, registry: Registry) -> None:
    """Write motions to `path` by its ending, all or nothing; an existing file is replaced. What it says of where they are from
    names no folder of whoever writes it.

    Raises
    ------
    FileError
        as :func:`writer_of`, or the folder cannot be written, or as
        :meth:`ClipWriter.write_all`.
    """
    writer = writer_of(path, registry)
    figures = [
        replace(figure, clip=replace(figure.clip, source=without_folder(figure.clip.source)))
        for figure in figures
    ]
    try:
        with tempfile.TemporaryDirectory(dir=path.parent, prefix=".writing-") as folder:
            temporary = Path(folder) / path.name
            try:
                writer.write_all(figures, temporary)
            except FileError as error:
                raise FileError(str(error).replace(str(temporary), str(path))) from error
            os.replace(temporary, path)
    except OSError as error:
        reason = error.strerror or type(error).__name__
        raise FileError(f"Clip {path}: cannot be written: {reason}.") from error
