"""Videos that appear completely or not at all, and stick figures that survive odd motions."""

from __future__ import annotations

import json
import re
import stat
from collections.abc import Iterator
from pathlib import Path
from xml.etree import ElementTree

import imageio_ffmpeg
import numpy as np
import pytest

from understudy.errors import RunError
from understudy.pictures import stick_figure_animation, stick_figure_svg, write_video


def frames(count: int = 10, shape: tuple[int, int] = (48, 64)) -> Iterator[np.ndarray]:
    for i in range(count):
        yield np.full((*shape, 3), 20 * i, dtype=np.uint8)


def walker(steps: int = 40, segments: int = 5) -> np.ndarray:
    """A bundle of upright lines 1 m high that moves along x at 1 m a frame, (T, S, 2, 3)."""
    figure = np.zeros((steps, segments, 2, 3))
    figure[..., 0] = np.arange(steps)[:, None, None] + 0.1 * np.arange(segments)[:, None]
    figure[..., 1] = np.linspace(-0.2, 0.2, segments)[:, None]
    figure[..., 1, 2] = 1.0
    return figure


@pytest.mark.parametrize("shape", [(48, 64), (47, 63)])
def test_video_is_h264_of_the_right_length(tmp_path: Path, shape: tuple[int, int]) -> None:
    path = tmp_path / "video.mp4"
    write_video(path, frames(12, shape), 1 / (1 / 30))
    reader = imageio_ffmpeg.read_frames(str(path))
    meta = next(reader)
    assert isinstance(meta, dict)
    assert meta["codec"] == "h264"
    assert meta["pix_fmt"].startswith("yuv420p")
    assert meta["fps"] == pytest.approx(30)
    assert meta["size"] == (64, 48)
    assert len(list(reader)) == 12
    assert list(tmp_path.iterdir()) == [path]


def test_failing_frames_leave_the_old_video(tmp_path: Path) -> None:
    path = tmp_path / "video.mp4"
    path.write_bytes(b"old")

    def broken() -> Iterator[np.ndarray]:
        yield from frames(3)
        raise KeyError("body")

    with pytest.raises(KeyError):
        write_video(path, broken(), 30)
    assert path.read_bytes() == b"old"
    assert list(tmp_path.iterdir()) == [path]


def test_frames_of_two_sizes_are_refused(tmp_path: Path) -> None:
    mixed = iter([*frames(2), *frames(1, (32, 32))])
    with pytest.raises(ValueError, match="a frame is"):
        write_video(tmp_path / "video.mp4", mixed, 30)
    assert not list(tmp_path.iterdir())


def test_no_frames(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="no frames"):
        write_video(tmp_path / "video.mp4", iter(()), 30)


def test_missing_folder(tmp_path: Path) -> None:
    with pytest.raises(RunError, match="could not be written"):
        write_video(tmp_path / "missing" / "video.mp4", frames(), 30)


def test_missing_encoder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(tmp_path / "missing"))
    with pytest.raises(RunError, match="cannot be started"):
        write_video(tmp_path / "video.mp4", frames(), 30)


@pytest.mark.parametrize(
    ("script", "reason"),
    [
        ('for last; do :; done; echo half > "$last"; echo "x: No space left on device" >&2; exit 1',
         "the disk is full"),
        ("echo one >&2; echo 'Unknown encoder.' >&2; exit 8", "ffmpeg says 'Unknown encoder'"),
        ("exit 3", "ffmpeg ended with 3"),
    ],
)  # fmt: skip
def test_encoder_that_gives_up(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, script: str, reason: str
) -> None:
    encoder, folder = tmp_path / "ffmpeg", tmp_path / "run"
    encoder.write_text(f"#!/bin/sh\n{script}\n")
    encoder.chmod(encoder.stat().st_mode | stat.S_IXUSR)
    folder.mkdir()
    monkeypatch.setenv("IMAGEIO_FFMPEG_EXE", str(encoder))
    with pytest.raises(RunError) as caught:
        write_video(folder / "video.mp4", frames(100, (480, 640)), 30)
    assert reason in str(caught.value)
    assert not list(folder.iterdir())


def test_filmstrip_shows_ten_poses_and_their_times() -> None:
    svg = stick_figure_svg(walker(31), walker(31), 0.1)
    ElementTree.fromstring(svg)
    assert svg.count("</text>") == 10
    assert ">0.0 s<" in svg
    assert ">3.0 s<" in svg
    assert svg.count("--reference") == 20  # far and near limbs of each pose


def test_filmstrip_keeps_poses_centred() -> None:
    """However far the figure walks, its coordinates are about its own middle."""
    far_away = stick_figure_svg(walker() + np.array([500.0, 0, 0]), None, 0.1)
    assert far_away == stick_figure_svg(walker(), None, 0.1)
    assert "--reference" not in far_away


@pytest.mark.parametrize("frames", [1, 2, 3])
def test_filmstrip_of_few_frames(frames: int) -> None:
    assert stick_figure_svg(walker(frames), None, 0.1).count("</text>") == frames


@pytest.mark.parametrize("shape", [(0, 5, 2, 3), (5, 0, 2, 3)])
def test_nothing_to_draw(shape: tuple[int, ...]) -> None:
    assert stick_figure_svg(np.zeros(shape), None, 0.1) == ""
    assert stick_figure_animation(np.zeros(shape), None, 0.1) == ""


@pytest.mark.parametrize("bad", [np.nan, np.inf, 1e30])
def test_numbers_that_cannot_be_drawn_are_left_out(bad: float) -> None:
    motion, reference = walker(), walker()
    motion[20:] = bad
    reference[3, 1, 0, 2] = bad
    strip = stick_figure_svg(motion, reference, 0.1)
    ElementTree.fromstring(strip)
    text = strip + stick_figure_animation(motion, reference, 0.1)
    assert not re.search(r"nan|inf\b|e\+|\d{12}", text, re.IGNORECASE)


def test_shapes_that_are_no_stick_figures() -> None:
    with pytest.raises(ValueError, match="T, S, 2, 3"):
        stick_figure_svg(np.zeros((4, 2, 3)), None, 0.1)
    with pytest.raises(ValueError, match="T, S, 2, 3"):
        stick_figure_animation(walker(4), walker(5), 0.1)


def test_animation_holds_every_frame_in_millimetres() -> None:
    html = stick_figure_animation(walker(7), walker(7), 1 / 30)
    found = re.search(r'<script type="application/json">(.*?)</script>', html)
    assert found is not None
    data = json.loads(found[1])
    assert data["dt"] == pytest.approx(1 / 30, abs=1e-6)
    assert len(data["frames"]) == 7
    *paths, centre = data["frames"][3]
    assert centre == 3200
    assert paths[2:] == [
        "M100 0L100 -1000M200 0L200 -1000",
        "M-200 0L-200 -1000M-100 0L-100 -1000M0 0L0 -1000",
    ]
    assert 'max="6"' in html
