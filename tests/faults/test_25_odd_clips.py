"""Fault 25: each odd clip has a stated outcome."""

from __future__ import annotations

import json
import time
import zipfile
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from motion_files import walker, write_npz

from understudy.errors import FileError
from understudy_motion.readers import deepmimic, npz
from understudy_motion.readers.table import NpzReader

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


@pytest.mark.parametrize(
    ("value", "reason"),
    [
        ("NaN", "not valid JSON: NaN is not a number"),
        ("-Infinity", "not valid JSON: -Infinity is not a number"),
        ("1e999", "frame 1: root position x is not finite"),
    ],
)
def test_json_that_is_no_number(tmp_path: Path, value: str, reason: str) -> None:
    """Python's reader of JSON takes each of these for a number."""
    text = json.dumps({"Loop": "none", "Frames": [frame(), frame(x=7.25)]}).replace("7.25", value)
    with pytest.raises(FileError, match=f"{reason}\\.$"):
        read(tmp_path, [], text)


@pytest.mark.parametrize(
    ("name", "reason"),
    [
        ("times", "time is not a finite number"),
        ("root_position", "root position is not finite"),
        ("rotations", "a rotation is not finite"),
    ],
)
@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_clip_of_no_numbers_is_none(name: str, reason: str, value: float) -> None:
    """However it was made: readers are not the only ones who make them."""
    clip = walker()
    spoiled = getattr(clip, name).clone()
    spoiled[2] = value
    with pytest.raises(FileError, match=f"frame 2: {reason}"):
        replace(clip, **{name: spoiled})


@pytest.mark.parametrize("name", ["root_position", "rotations"])
def test_arrays_of_no_numbers(tmp_path: Path, name: str) -> None:
    with np.load(write_npz(tmp_path)) as file:
        arrays = dict(file)
    arrays[name][3] = np.nan
    np.savez(tmp_path / "odd.npz", **arrays)
    with pytest.raises(FileError, match=f"frame 3: '{name}' is not finite"):
        NpzReader().read(tmp_path / "odd.npz")


def test_arrays_beyond_the_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Together: each of them would be allowed. The directory says it, before anything is unpacked."""
    path = write_npz(tmp_path)
    with zipfile.ZipFile(path) as file:
        sizes = [member.file_size for member in file.infolist()]
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", sum(sizes))
    NpzReader().read(path)
    monkeypatch.setattr(npz, "MAX_ARRAY_BYTES", sum(sizes) - 1)
    assert max(sizes) < sum(sizes) - 1
    with pytest.raises(FileError, match="the arrays are larger than"):
        NpzReader().read(path)
