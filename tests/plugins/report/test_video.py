"""Videos that appear completely or not at all."""

from __future__ import annotations

import errno
import os
import signal
import stat
import subprocess
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import imageio_ffmpeg
import numpy as np
import pytest

from understudy.errors import RunError
from understudy.signals import StopRequest
from understudy_report import video
from understudy_report.video import write_video


def frames(count: int = 10, shape: tuple[int, int] = (48, 64)) -> Iterator[np.ndarray]:
    for i in range(count):
        yield np.full((*shape, 3), 20 * i, dtype=np.uint8)


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


def test_a_disk_that_is_read_only(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Where not even what is not there can be removed."""

    def refuse(path: Path, missing_ok: bool = False) -> None:
        raise OSError(errno.EROFS, "Read-only file system", str(path))

    monkeypatch.setattr(Path, "unlink", refuse)
    with pytest.raises(RunError, match=r"/nowhere/film\.mp4 could not be written: ffmpeg says "):
        write_video(tmp_path / "nowhere/film.mp4", frames(), 30.0)


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
        write_video(folder / "video.mp4", frames(12, (480, 640)), 30)
    assert reason in str(caught.value)
    assert not list(folder.iterdir())


def test_no_folder_for_temporary_files_is_needed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As in a container where only the run's folder can be written."""
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("tempfile._candidate_tempdir_list", lambda: ["/proc/nowhere"])
    write_video(tmp_path / "video.mp4", frames(), 30)
    assert (tmp_path / "video.mp4").stat().st_size > 0


@pytest.mark.parametrize("folder", ["a:b", "http:", "-x", "50%d"])
def test_folders_whose_names_mean_something_to_ffmpeg(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, folder: str
) -> None:
    monkeypatch.chdir(tmp_path)
    Path(folder).mkdir()
    write_video(Path(folder) / "video.mp4", frames(), 30)
    assert [str(p) for p in Path(folder).iterdir()] == [f"{folder}/video.mp4"]


def test_many_messages_do_not_stop_the_encoder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """More than fits in a pipe, before it has taken a frame."""
    script = tmp_path / "ffmpeg"
    script.write_text("#!/bin/sh\nseq 100000 >&2\ncat > /dev/null\necho last words >&2\nexit 1\n")
    script.chmod(0o755)
    monkeypatch.setattr(imageio_ffmpeg, "get_ffmpeg_exe", lambda: str(script))
    with pytest.raises(RunError, match="ffmpeg says 'last words'"):
        write_video(tmp_path / "video.mp4", frames(12, (480, 640)), 30)


def test_a_stop_as_the_encoder_begins_leaves_neither_it_nor_a_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    begin, begun = subprocess.Popen, list[Any]()

    def stopped(*arguments: Any, **more: Any) -> Any:
        begun.append(begin(*arguments, **more))
        os.kill(os.getpid(), signal.SIGTERM)
        return begun[-1]

    monkeypatch.setattr(video.subprocess, "Popen", stopped)
    with pytest.raises(KeyboardInterrupt), StopRequest(at_once=True) as request:
        write_video(tmp_path / "video.mp4", frames(), 30.0)
    assert request.received == signal.SIGTERM
    assert begun[0].returncode is not None, "the encoder goes on"
    assert not list(tmp_path.iterdir())
