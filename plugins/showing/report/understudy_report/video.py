"""Videos of frames, encoded as they are drawn."""

from __future__ import annotations

import argparse
import os
import subprocess
from collections.abc import Iterator
from contextlib import suppress
from fractions import Fraction
from itertools import chain
from pathlib import Path
from threading import Thread

import numpy as np

from understudy.errors import RunError
from understudy.signals import StopRequest

__all__ = ["LONGEST", "length", "video_file", "write_video"]

#: s of a video that a command makes, whose frames are in memory.
LONGEST = 3600.0


def video_file(text: str) -> Path:
    """An argument's type: the file of a video, whose name says so to whatever is to show it."""
    if Path(text).suffix.lower() != ".mp4":
        raise argparse.ArgumentTypeError(
            f"{text} is no video's name: give one that ends in .mp4, such as walk.mp4"
        )
    return Path(text)


def length(text: str) -> float:
    """An argument's type: seconds of a video."""
    if not 0.0 < (seconds := float(text)) <= LONGEST:
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and at most {LONGEST:g} s")
    return seconds


def write_video(path: Path, frames: Iterator[np.ndarray], fps: float) -> None:
    """Write `frames`, each (H, W, 3) uint8, as an H.264 video that every browser plays.

    The file appears when it is complete; until then, and after an error, what was there stays.

    Raises
    ------
    RunError
        if there are no frames, no encoder, or no room on the disk.
    """
    first = next(frames, None)
    if first is None:
        raise RunError(f"{path} was not written: there are no frames to show.")
    temporary = path.parent / f".{path.name}.{os.getpid()}.partial"
    try:
        reason = _encode(temporary, chain([first], frames), first.shape, fps)
        if reason is None:
            reason = _move(temporary, path)
    finally:
        with suppress(OSError):  # it is there only if that did not end
            temporary.unlink()
    if reason is not None:
        raise RunError(f"{path} could not be written: {reason}.")


def _encode(
    path: Path, frames: Iterator[np.ndarray], shape: tuple[int, ...], fps: float
) -> str | None:
    """Encode `frames` of one `shape` (H, W, 3) into `path`; returns why it failed, if it did."""
    height, width, _ = shape
    try:
        import imageio_ffmpeg  # a training needs no encoder, so only this fails without one

        command = [imageio_ffmpeg.get_ffmpeg_exe()]
    except (ImportError, RuntimeError):
        return "there is no ffmpeg, which imageio-ffmpeg brings or the system provides"
    command += ["-y", "-v", "error", "-f", "rawvideo", "-pix_fmt", "rgb24"]
    command += ["-s", f"{width}x{height}", "-r", str(Fraction(fps).limit_denominator(1001))]
    # Colour is stored for blocks of 2×2 pixels, so odd sizes are padded.
    command += ["-i", "-", "-an", "-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2"]
    # Frames are often drawn on the same cores, and are few: a quick encoding is small enough.
    command += ["-c:v", "libx264", "-preset", "veryfast"]
    command += ["-pix_fmt", "yuv420p", "-movflags", "+faststart", "-f", "mp4"]
    command += [f"file:{path}"]  # else what stands before a colon would be a protocol
    messages: list[bytes] = []
    encoder = listener = None
    try:
        with StopRequest():  # which would leave an encoder that has just begun to itself
            encoder = subprocess.Popen(command, stdin=subprocess.PIPE, stderr=subprocess.PIPE)
            # Messages are read while frames are written, or it would wait; into no file, for which there may be no place.
            listener = Thread(target=messages.extend, args=(encoder.stderr,), daemon=True)
            listener.start()
        assert encoder.stdin is not None
        for frame in frames:
            if frame.shape != shape or frame.dtype != np.uint8:
                raise ValueError(f"a frame is {frame.dtype} {frame.shape}, not uint8 {shape}")
            try:
                encoder.stdin.write(np.ascontiguousarray(frame).data)
            except BrokenPipeError:
                break
    except BaseException as error:
        if encoder is not None:
            encoder.kill()
        elif isinstance(error, OSError):
            return f"ffmpeg cannot be started ({error.strerror})"
        raise
    finally:
        status = -1 if encoder is None else _ended(encoder, listener)
    text = b"".join(messages).decode(errors="replace")
    if status == 0:
        return None
    if "No space left" in text:
        return "the disk is full"
    lines = text.strip().splitlines()
    return f"ffmpeg says '{lines[-1].strip(' .')}'" if lines else f"ffmpeg ended with {status}"


def _ended(encoder: subprocess.Popen[bytes], listener: Thread | None) -> int:
    """Close what goes to and comes from an encoder, and wait for its end; its exit status."""
    assert encoder.stdin is not None
    assert encoder.stderr is not None
    with suppress(BrokenPipeError):  # it has given up; its messages say why
        encoder.stdin.close()
    status = encoder.wait()
    if listener is not None:
        listener.join()
    encoder.stderr.close()
    return status


def _move(temporary: Path, path: Path) -> str | None:
    try:
        os.replace(temporary, path)
    except OSError as error:
        return str(error.strerror)
    return None
