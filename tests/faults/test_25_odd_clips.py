"""Fault 25: each odd clip has a stated outcome."""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import pytest

from understudy.errors import FileError
from understudy_motion.readers import deepmimic

IDENTITY = [1.0, 0.0, 0.0, 0.0]


def frame(duration: float = 0.1, x: float = 0.0) -> list[Any]:
    root = [duration, x, 0.9, 0.0, *IDENTITY]
    leg, arm = [*IDENTITY, 0.0, *IDENTITY], [*IDENTITY, 0.0]
    return [*root, *IDENTITY, *IDENTITY, *leg, *arm, *leg, *arm]


def read(folder: Path, frames: list[list[Any]], text: str | None = None) -> Any:
    file = folder / "clip.txt"
    file.write_bytes((text or json.dumps({"Loop": "none", "Frames": frames})).encode())
    return deepmimic.DeepMimicReader().read(file)


@pytest.mark.parametrize(
    ("frames", "reason"),
    [
        ([], "0 frames"),
        ([frame()], "1 frames"),
        ([frame(), frame()[:-1]], "frame 1"),
        ([frame(), [*frame(), 0.0]], "frame 1"),
        ([frame(-0.1), frame()], "frame 0"),
        ([frame(), [*frame()[:4], 9.0, 0.0, 0.0, 0.0, *frame()[8:]]], "frame 1"),
    ],
    ids=["no frame", "one frame", "short row", "long row", "negative dt", "non-unit rotation"],
)
def test_refused_with_file_and_place(tmp_path: Path, frames: list[Any], reason: str) -> None:
    with pytest.raises(FileError) as caught:
        read(tmp_path, frames)
    assert str(tmp_path / "clip.txt") in str(caught.value)
    assert reason in str(caught.value)


def test_line_endings_do_not_matter(tmp_path: Path) -> None:
    text = json.dumps({"Loop": "wrap", "Frames": [frame(), frame(x=0.1)]}, indent=1)
    assert read(tmp_path, [], text.replace("\n", "\r\n")).num_frames == 2


def test_a_million_frames_are_refused_quickly(tmp_path: Path) -> None:
    row = json.dumps(frame())
    text = '{"Loop": "none", "Frames": [' + ",".join([row] * 1_000_000) + "]}"
    began = time.monotonic()
    with pytest.raises(FileError):
        read(tmp_path, [], text)
    assert time.monotonic() - began < 5
