"""Makes the report of a run once it is judged."""

from __future__ import annotations

import functools
import time
from collections.abc import Callable

from understudy.errors import UnderstudyError
from understudy.records.observer import RunObserver
from understudy.records.recording import Recording
from understudy.records.runs import Run
from understudy_report.motion import FIGURES, VIDEO, Figures
from understudy_report.page import write_report
from understudy_report.video import write_video

#: Of a video, in pixels. Frames are often drawn without a GPU, in time proportional to these.
WIDTH, HEIGHT = 800, 450
#: A video shows every frame of the recording up to about this rate, and every n-th beyond, in Hz.
FRAME_RATE = 30.0


class ReportMaker(RunObserver):
    """Writes ``stick_figures.npz``, ``video.mp4`` if it can be drawn, and ``report.html``."""

    def judged(self, run: Run, recording: Recording | None, tell: Callable[[str], None]) -> None:
        pictures = (("stick figures", FIGURES, _draw_figures), ("video", VIDEO, _draw_video))
        for what, name, draw in pictures:
            drawn = False
            if recording is not None and recording.tracks:
                drawn = self._try(what, tell, functools.partial(draw, run, recording, tell))
            if not drawn:  # what is there is of an earlier recording
                (run.path / name).unlink(missing_ok=True)
        tell(f"The report is {write_report(run)}.")

    def evaluated(self, run: Run, tell: Callable[[str], None]) -> None:
        tell(f"The report is {write_report(run)}.")

    def _try(self, what: str, tell: Callable[[str], None], draw: Callable[[], bool]) -> bool:
        """Whether there is one. The page is worth having without a picture, whatever kept its scene from drawing."""
        try:
            return draw()
        except UnderstudyError as error:
            tell(f"No {what}: {error}")
        except Exception as error:  # a scene may come from any plugin
            tell(f"No {what}: {type(error).__name__}: {error}")
        return False


def _draw_figures(run: Run, recording: Recording, tell: Callable[[str], None]) -> bool:
    learned, reference = recording.scene.outlines(recording.tracks)
    if learned is not None:
        Figures(learned, reference, recording.control_dt).save(run.path / FIGURES)
    return learned is not None


def _draw_video(run: Run, recording: Recording, tell: Callable[[str], None]) -> bool:
    """Draws and encodes at once, and says how long that took."""
    began = time.perf_counter()
    every = max(1, round(1.0 / (FRAME_RATE * recording.control_dt)))
    tracks = {name: track[::every] for name, track in recording.tracks.items()}
    options = run.config.get("run") or {}
    width, height = options.get("video_size") or (WIDTH, HEIGHT)
    recording.scene.azimuth = options.get("video_camera")
    frames = recording.scene.draw(tracks, width, height)
    write_video(run.path / VIDEO, frames, 1.0 / (every * recording.control_dt))
    tell(f"Video drawn in {time.perf_counter() - began:.0f} s.")
    return True
