"""Which reader reads a file is decided by its content, and every recorded file is read."""

from __future__ import annotations

import bz2
import gzip
import lzma
import os
import pickle
import re
import zipfile
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import torch
from motion_files import WRITE
from worlds import little_memory

import understudy_motion
from understudy.errors import FileError
from understudy.setup.registry import Registrar, Registry
from understudy_motion import library, limits, origin
from understudy_motion.kinematics import forward_kinematics
from understudy_motion.reading import (
    HEAD_BYTES,
    ReadOptions,
    UnknownFormatError,
    read_clip,
    readers,
)


@pytest.fixture(scope="module")
def registry() -> Registry:
    made = Registry()
    Registrar(made, "motion").tables(understudy_motion)
    return made


def test_every_reader_has_an_example(registry: Registry) -> None:
    assert set(readers(registry)) == set(WRITE)


@pytest.mark.parametrize("name", WRITE)
@pytest.mark.parametrize("disguise", ["clip.txt", "clip", "clip.json", "clip.npz"])
def test_content_decides(tmp_path: Path, registry: Registry, name: str, disguise: str) -> None:
    path = WRITE[name](tmp_path).rename(tmp_path / disguise)
    head = path.read_bytes()[:HEAD_BYTES]
    assert [n for n, r in readers(registry).items() if r.recognises(head, path)] == [name]
    assert read_clip(path, registry).num_frames == 6


@pytest.mark.parametrize(
    "content",
    [
        b"",
        b"\0" * 5000,
        b"PK\x03\x04 but no archive",
        b"just text, with a comma",
        b"a,b,c\n1,2,3\n",
        b'{"asset": {"version": "2.0"}, "scenes": []}',
        b'{"Skeleton": {"Joints": []}}',
        b"[1, 2, 3]",
        b"\xff\xfe\x00\x01",
    ],
)
def test_other_content_is_nobodys(tmp_path: Path, registry: Registry, content: bytes) -> None:
    for name in ("clip.bvh", "clip.json", "clip.npz", "clip.csv", "clip.amc"):
        path = tmp_path / name
        path.write_bytes(content)
        said = r"not a format that is read here \(amc, angles, bvh"
        if not content:
            said = "the file is empty"
        elif content.startswith(b"PK") and path.suffix == ".npz":
            said = "a damaged NPZ"
        with pytest.raises(UnknownFormatError, match=said):
            read_clip(path, registry)


@pytest.mark.parametrize(
    ("pack", "name"),
    [(gzip.compress, "gzip"), (bz2.compress, "bzip2"), (lzma.compress, "xz"), (None, "zip")],
)
def test_a_packed_file_says_so(
    tmp_path: Path, registry: Registry, pack: Callable[[bytes], bytes] | None, name: str
) -> None:
    clip, path = WRITE["bvh"](tmp_path), tmp_path / f"walker.bvh.{name}"
    if pack:
        path.write_bytes(pack(clip.read_bytes()))
    else:
        with zipfile.ZipFile(path, "w") as archive:
            archive.write(clip, "walker.bvh")
    with pytest.raises(UnknownFormatError, match=f"packed by {name}. Unpack it"):
        read_clip(path, registry)


@pytest.mark.parametrize(
    ("content", "said"),
    [
        (b"Kaydara FBX Binary  \0", "an FBX file, which is not read here. Export it as BVH"),
        (b"; FBX 7.4.0 project file", "an FBX file, which is not read here. Export it as BVH"),
        (b"glTF\2\0\0\0", "Export it as BVH"),
        (b"PAR1\x15\0", "a Parquet file, which is not read here. Export it as CSV"),
        (
            b"PK\3\4\x14\0[Content_Types].xml",
            "a spreadsheet, which is not read here. Export it as CSV",
        ),
    ],
)
def test_what_other_programs_can_export(
    tmp_path: Path, registry: Registry, content: bytes, said: str
) -> None:
    path = tmp_path / "clip"
    path.write_bytes(content)
    with pytest.raises(UnknownFormatError, match=re.escape(said)):
        read_clip(path, registry)


def test_what_could_run_code_or_has_no_names_says_so(tmp_path: Path, registry: Registry) -> None:
    path = tmp_path / "clip"
    for write in (pickle.dump, torch.save):
        with path.open("wb") as file:
            write({"poses": [0.0] * 66}, file)
        with pytest.raises(UnknownFormatError, match="a pickle, which could run any code"):
            read_clip(path, registry)
    packed = [zlib.compress(pickle.dumps([0.0] * 66), level) for level in (1, 3, 6, 9)]  # joblib's
    for content in (*packed, pickle.dumps({"poses": [0.0] * 66}, protocol=0)):
        path.write_bytes(content)
        with pytest.raises(UnknownFormatError, match="a pickle, which could run any code"):
            read_clip(path, registry)
    with path.open("wb") as file:
        np.save(file, np.zeros((6, 66)))
    with pytest.raises(UnknownFormatError, match="one array without names"):
        read_clip(path, registry)


@pytest.mark.parametrize(
    ("name", "options", "said"),
    [
        ("npz", {"unit": "cm"}, r"unit of length, m; leave motion\.unit=cm \(--unit\) out"),
        ("npz", {"rate": 30.0}, r"their times; leave motion\.rate=30\.0 \(--source-rate\) out"),
        ("csv", {"up": "y"}, r"which axis is vertical, z; leave motion\.up=y \(--up\) out"),
        ("deepmimic", {"up": "z"}, "which axis is vertical, y; leave"),
        (
            "npz",
            {"angles": "degrees"},
            r"unit of their angles, or have none; leave motion\.angles=degrees \(--angles\) out",
        ),
        ("deepmimic", {"angles": "radians"}, "the unit of their angles, or have none"),
        ("bvh", {"skeleton": Path("x.asf")}, r"their skeleton.*\(--skeleton\) out"),
    ],
)
def test_what_a_file_says_itself_is_not_given(
    tmp_path: Path, registry: Registry, name: str, options: dict[str, Any], said: str
) -> None:
    path = WRITE[name](tmp_path)
    with pytest.raises(FileError, match=said):
        read_clip(path, registry, ReadOptions(**options))
    assert read_clip(path, registry, ReadOptions(**readers(registry)[name].fixed)).num_frames > 1


def test_what_an_npz_lacks_is_said(tmp_path: Path, registry: Registry) -> None:
    path = tmp_path / "clip.npz"
    np.savez(path, **{"motion/poses": np.zeros((6, 66)), "fps": 30})
    with pytest.raises(
        UnknownFormatError, match="It has 'fps', 'motion/poses'; AMASS and its like"
    ):
        read_clip(path, registry)
    np.savez(path, poses=np.zeros((6, 66)), trans=np.zeros((6, 3)), fps=30)
    path.write_bytes(path.read_bytes()[:-100])
    with pytest.raises(UnknownFormatError, match="a damaged NPZ, perhaps one that was not fetched"):
        read_clip(path, registry)
    path.write_bytes(b"")
    with pytest.raises(UnknownFormatError, match="the file is empty"):
        read_clip(path, registry)


def test_a_skeleton_alone(tmp_path: Path, registry: Registry) -> None:
    WRITE["amc"](tmp_path)
    with pytest.raises(FileError, match=r"is a skeleton \(ASF\) without a motion"):
        read_clip(tmp_path / "small.asf", registry)


@pytest.mark.parametrize("name", ["amc", "bvh", "csv", "npz", "smpl"])
def test_clips_too_large_are_refused(
    tmp_path: Path, registry: Registry, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = WRITE[name](tmp_path)
    monkeypatch.setattr(limits, "MAX_ROTATIONS", 10)
    with pytest.raises(FileError, match=r"6 frames of \d+ joints are too many; cut it"):
        read_clip(path, registry)
    monkeypatch.setattr(limits, "MAX_JOINTS", 4)
    with pytest.raises(FileError, match=r"joints; at most 4 are read|more than 4 joints"):
        read_clip(path, registry)


def recorded() -> list[Path]:
    folder = library.data_folder()
    found = sorted(folder.glob("motions/*/*")) if folder else []
    return [
        path
        for path in found
        if path.suffix in (".amc", ".txt") and not path.stem.endswith("character")
    ]


@pytest.mark.skipif(not recorded(), reason="no recorded clips: UNDERSTUDY_DATA is not set")
def test_every_recorded_clip_is_a_person_in_motion(registry: Registry) -> None:
    for path in recorded():
        clip = read_clip(path, registry)
        positions, world = forward_kinematics(clip)
        assert positions.isfinite().all(), path
        assert world.norm(dim=-1).sub(1.0).abs().max() < 1e-9, path
        extent = (positions.amax(dim=1) - positions.amin(dim=1)).norm(dim=-1)
        assert 0.8 < extent.median() < 2.6, path
        # Nothing hangs far below or far above the floor it was recorded on.
        lowest = positions[..., 2].amin(dim=1)
        assert torch.quantile(lowest, 0.1) > -0.3, path
        assert torch.quantile(lowest, 0.1) < 0.5, path


@pytest.mark.timeout(20)
@pytest.mark.parametrize("what", ["/dev/zero", "pipe", "long"])
def test_a_licence_without_end_is_not_read(tmp_path: Path, what: str) -> None:
    licence = tmp_path / origin.LICENCE
    if what == "pipe":
        os.mkfifo(licence)
    elif what == "long":
        licence.write_text("CC0 " * 10**6)
    else:
        licence.symlink_to(what)
    with little_memory():
        said = origin.licence_beside(tmp_path / "clip.txt")
    assert len(said) < 300
    assert said.startswith("CC0" if what == "long" else "unknown")
