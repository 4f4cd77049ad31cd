"""What a run's observers leave: pictures and page, or a sentence; and TensorBoard's files."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest
from report_runs import Page, make_run
from tensorboard.backend.event_processing.event_accumulator import EventAccumulator

from understudy.errors import FileError, RunError
from understudy.records.recording import Recording
from understudy.records.runs import Run
from understudy.setup.plugins import installed
from understudy.task import Scene
from understudy_motion.readers import npz
from understudy_report.maker import HEIGHT, WIDTH, ReportMaker
from understudy_report.motion import FIGURES, VIDEO, Figures
from understudy_report.progress import ProgressLine
from understudy_report.tensorboard import TensorBoard


class Points(Scene):
    """Upright lines at the recorded positions; drawn as frames of one grey each."""

    recorded = ("x",)

    def describe(self) -> dict[str, Any]:
        return {}

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 64, height: int = 48
    ) -> Iterator[np.ndarray]:
        for x in tracks["x"]:
            yield np.full((height, width, 3), x, dtype=np.uint8)

    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        figure = np.zeros((len(tracks["x"]), 1, 2, 3))
        figure[:, 0, :, 0] = tracks["x"][:, None]
        figure[:, 0, 1, 2] = 1.0
        return figure, None


class NoOpenGL(Points):
    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 64, height: int = 48
    ) -> Iterator[np.ndarray]:
        return Scene.draw(self, tracks)


class Broken(Points):
    def outlines(
        self, tracks: Mapping[str, np.ndarray]
    ) -> tuple[np.ndarray | None, np.ndarray | None]:
        raise KeyError("qpos")


def recording(scene: Scene, frames: int = 12, dt: float = 1 / 30) -> Recording:
    return Recording({"x": np.arange(frames, dtype=np.float32)}, dt, frames, scene)


def made(run: Run, of: Recording) -> tuple[list[str], Page]:
    messages: list[str] = []
    ReportMaker().judged(run, of, messages.append)
    return messages, Page((run.path / "report.html").read_text())


class Stopped(Points):
    """A signal comes while the film is drawn."""

    def draw(
        self, tracks: Mapping[str, np.ndarray], width: int = 64, height: int = 48
    ) -> Iterator[np.ndarray]:
        yield from super().draw({"x": tracks["x"][:3]}, width, height)
        raise KeyboardInterrupt("SIGTERM")


def test_what_is_stopped_leaves_the_earlier_film(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    made(run, recording(Points()))
    before = {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()}
    with pytest.raises(KeyboardInterrupt):
        ReportMaker().judged(run, recording(Stopped()), lambda text: None)
    assert {path: path.read_bytes() for path in tmp_path.rglob("*") if path.is_file()} == before


def test_no_film_of_an_earlier_recording_is_left(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    made(run, recording(Points()))
    made(run, recording(NoOpenGL()))
    assert (tmp_path / FIGURES).exists()
    assert not (tmp_path / VIDEO).exists()
    made(run, Recording({}, 1 / 30, 0, Points()))
    assert not (tmp_path / FIGURES).exists()


def test_video_figures_and_page(tmp_path: Path) -> None:
    run = make_run(tmp_path)
    messages, page = made(run, recording(Points()))
    assert [m.split()[0] for m in messages] == ["Video", "The"]
    assert messages[-1] == f"The report is {tmp_path / 'report.html'}."
    reader = imageio_ffmpeg.read_frames(str(tmp_path / VIDEO))
    meta = next(reader)
    assert isinstance(meta, dict)
    assert meta["size"] == (WIDTH, HEIGHT)
    assert len(list(reader)) == 12
    figures = Figures.load(tmp_path / FIGURES)
    assert figures is not None
    assert figures.dt == pytest.approx(1 / 30)
    np.testing.assert_array_equal(figures.learned[:, 0, 1, 0], np.arange(12))
    assert "video" in page.tags
    assert "0.4 s" in page.text  # the filmstrip's last pose


@pytest.mark.parametrize(
    ("dt", "frames", "rate"), [(1 / 60, 6, 30), (1 / 120, 3, 30), (0.1, 12, 10)]
)
def test_a_video_has_at_most_about_30_frames_a_second(
    tmp_path: Path, dt: float, frames: int, rate: float
) -> None:
    made(make_run(tmp_path), recording(Points(), 12, dt))
    reader = imageio_ffmpeg.read_frames(str(tmp_path / VIDEO))
    meta = next(reader)
    assert isinstance(meta, dict)
    assert meta["fps"] == pytest.approx(rate)
    assert len(list(reader)) == frames


def test_without_opengl_the_player_takes_the_videos_place(tmp_path: Path) -> None:
    (tmp_path / VIDEO).write_bytes(b"of an earlier recording")
    messages, page = made(make_run(tmp_path), recording(NoOpenGL()))
    assert messages[0] == "No video: scene NoOpenGL cannot be drawn."
    assert not (tmp_path / VIDEO).exists()
    assert "Play" in page.text


def test_a_scene_that_breaks_costs_its_picture_only(tmp_path: Path) -> None:
    messages, page = made(make_run(tmp_path), recording(Broken()))
    assert messages[0] == "No stick figures: KeyError: 'qpos'"
    assert "video" in page.tags
    assert "Provenance" in page.headings


def test_figures_of_any_numbers_but_no_larger_than_a_clip(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A simulation that blew up is drawn as far as it can be."""
    learned = np.full((3, 2, 2, 3), np.nan)
    Figures(learned, learned, 0.1).save(tmp_path / FIGURES)
    figures = Figures.load(tmp_path / FIGURES)
    assert figures is not None
    np.testing.assert_array_equal(figures.reference, learned)
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", 200)
    with pytest.raises(FileError, match="the arrays are larger than"):
        Figures.load(tmp_path / FIGURES)


def test_nothing_recorded(tmp_path: Path) -> None:
    """A scene that wants nothing recorded: a report without motion, not that of an earlier one."""
    made(make_run(tmp_path), recording(NoOpenGL()))
    messages, page = made(make_run(tmp_path), Recording({}, 1 / 30, 0, Points()))
    assert len(messages) == 1
    assert "Motion" not in page.headings


def test_a_report_that_cannot_be_written_is_an_error(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="could not be written"):
        ReportMaker().judged(
            make_run(tmp_path / "missing"), Recording({}, 1 / 30, 0, Points()), lambda text: None
        )


def test_the_recording_of_a_run_as_a_file(tmp_path: Path) -> None:
    recording(Points()).save(tmp_path / "recording.npz")
    with np.load(tmp_path / "recording.npz") as arrays:
        assert sorted(arrays) == ["control_dt", "first_episode", "x"]
        assert int(arrays["first_episode"]) == 12


def test_the_plugins_observers() -> None:
    known = installed().registry.components.values()
    found = [c.factory for c in known if (c.kind, c.plugin) == ("observer", "report")]
    assert found == [ProgressLine, TensorBoard, ReportMaker]


def test_tensorboard_has_every_metric_at_its_samples(tmp_path: Path) -> None:
    run, board = make_run(tmp_path), TensorBoard()
    board.started(run)
    board.iteration(run, {"iteration": 1, "samples": 64, "reward": 0.5}, "")
    board.iteration(run, {"iteration": 1, "samples": 64, "evaluation/success_rate": 0.75}, "")
    board.finished(run, "budget")
    events = EventAccumulator(str(tmp_path / "tensorboard"))
    events.Reload()
    assert sorted(events.Tags()["scalars"]) == ["evaluation/success_rate", "reward"]
    assert [(e.step, e.value) for e in events.Scalars("evaluation/success_rate")] == [(64, 0.75)]


def test_the_kernel_draws_nothing() -> None:
    """Pages, pictures, videos and loggers are this plugin's."""
    import understudy

    kernel = Path(understudy.__file__).parent
    drawing = re.compile(r"<svg|<html|ffmpeg|SummaryWriter|import tensorboard", re.IGNORECASE)
    assert [f.name for f in kernel.rglob("*.py") if drawing.search(f.read_text())] == []
