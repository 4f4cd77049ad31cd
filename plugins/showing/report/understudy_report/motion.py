"""The learned motion: the video or a stick figure player, and a filmstrip."""

from __future__ import annotations

import base64
import io
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from understudy.folders import read, write_atomically
from understudy.records.runs import Run
from understudy_motion.readers.npz import Archive
from understudy_report.section import ReportSection
from understudy_report.stick_figures import stick_figure_animation, stick_figure_svg

__all__ = ["FIGURES", "Figures"]

#: Files of the run folder.
VIDEO = "video.mp4"
FIGURES = "stick_figures.npz"


@dataclass(frozen=True)
class Figures:
    """Stick figures of a recorded motion and of its reference: line segments, world frame, z up."""

    learned: np.ndarray  #: (T, S, 2, 3) m
    reference: np.ndarray | None  #: (T, S, 2, 3) m
    dt: float  #: s between frames

    def save(self, path: Path) -> None:
        """Write them as the npz file `path`; a RunError if that cannot be written."""
        arrays = {"learned": self.learned.astype(np.float32), "dt": np.array(self.dt)}
        if self.reference is not None:
            arrays["reference"] = self.reference.astype(np.float32)
        file = io.BytesIO()
        np.savez(file, **arrays)
        write_atomically(path, file.getvalue())

    @staticmethod
    def load(path: Path) -> Figures | None:
        """Those of the file `path`, or None if there is none; a FileError if it is damaged."""
        if not path.is_file():
            return None
        archive = Archive(path)
        reference = archive.numbers("reference") if "reference" in archive.names else None
        return Figures(archive.numbers("learned"), reference, archive.number("dt"))


class Motion(ReportSection):
    """The video, or the stick figure player in its place, and the filmstrip."""

    title = "Motion"
    order = 20

    def html(self, run: Run) -> str | None:
        figures = Figures.load(run.path / FIGURES)
        parts = []
        try:
            data = base64.b64encode(read(run.path / VIDEO)).decode()
            parts.append(
                '<div class="card"><video autoplay muted loop controls playsinline '
                f'src="data:video/mp4;base64,{data}"></video></div>'
            )
        except OSError:
            if figures is not None:
                player = stick_figure_animation(figures.learned, figures.reference, figures.dt)
                parts += [f'<div class="card">{player}</div>'] if player else []
        if figures is not None:
            strip = stick_figure_svg(figures.learned, figures.reference, figures.dt)
            parts += [f'<div class="card strip">{strip}</div>'] if strip else []
        if figures is not None and parts:
            names = ["learned"] if figures.reference is None else ["learned", "reference"]
            key = "".join(f'<span class="key {name}">{name}</span>' for name in names)
            parts.append(f"<p>{key} Limbs on the far side are drawn fainter.</p>")
        return "".join(parts) or None
