"""Fault 24: archives whose arrays are of odd types, of nothing, of much in little, or no text end in one sentence."""

from __future__ import annotations

import io
import time
import tracemalloc
import warnings
import zipfile
from pathlib import Path

import numpy as np
import pytest
from motion_files import WRITE

from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_motion.readers import npz
from understudy_motion.reading import read_clip

REGISTRY = installed().registry
MEGABYTES = 300


def saved(array: np.ndarray, shape: str = "") -> bytes:
    """The array as an NPY file, which says that it has this shape."""
    out = io.BytesIO()
    np.save(out, array)
    return out.getvalue().replace(str(array.shape).encode(), (shape or str(array.shape)).encode())


def empty(*shape: int) -> bytes:
    """An NPY file of no bytes whose shape has a 0 in it."""
    out = io.BytesIO()
    said = {"descr": "<f8", "fortran_order": False, "shape": shape}
    np.lib.format.write_array_header_1_0(out, said)
    return out.getvalue()


def archive(folder: Path, kind: str, **arrays: np.ndarray | bytes | None) -> Path:
    """The valid file of the `kind` with these arrays in place of its own; of None there is none."""
    path = WRITE[kind](folder)
    with zipfile.ZipFile(path) as file:
        members = {name: file.read(name) for name in file.namelist()}
    for name, array in arrays.items():
        members.pop(f"{name}.npy", None)
        if array is not None:
            members[f"{name}.npy"] = array if isinstance(array, bytes) else saved(array)
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as file:
        for name, content in members.items():
            file.writestr(name, content)
    return path


def refused(path: Path) -> str:
    """How reading the file is refused, soon, in little memory and without a warning."""
    tracemalloc.start()
    began = time.process_time()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error")
            with pytest.raises(FileError) as found:
                read_clip(path, REGISTRY)
        assert time.process_time() - began < 3.0
        assert tracemalloc.get_traced_memory()[1] < MEGABYTES * 2**20
    finally:
        tracemalloc.stop()
    assert "\n" not in str(found.value)
    assert str(found.value).isprintable()
    return str(found.value)


SIGNALLING = np.frombuffer(b"\x01\x00\xa0\x7f" * 18, "<f4").reshape(6, 3)
NO_CODE = np.frombuffer(b"\xff\xff\xff\x7f" * 3, "<U1")
SURROGATE = np.frombuffer(b"\x00\xd8\x00\x00" * 3, "<U1")
WIDE = empty(0, 30_000_000)
MANY = np.zeros(30_000_000, np.int8)


@pytest.mark.parametrize(
    ("arrays", "said"),
    [
        ({"qpos": WIDE}, "at most 1000 are read"),
        ({"dof_pos": WIDE, "root_pos": np.zeros((0, 3)), "root_rot": np.zeros((0, 4))}, "at most 1000"),
        ({"qpos": empty(30_000_000, 0)}, "0 numbers a frame"),
        ({"qpos": np.zeros((0, 9))}, "at least 2 frames"),
        ({"dof_pos": np.zeros((6, 0))}, "7 numbers a frame"),
        ({"qpos": MANY.reshape(-1, 10)}, "too many"),
        ({"qpos": np.zeros((12_000_000, 10), np.int8)}, "more than is read"),
        ({"joint_names": np.zeros(20_000_000, "U1")}, "more than is read"),
        ({"joint_names": NO_CODE}, "no text"),
        ({"joint_names": SURROGATE}, "no text"),
        ({"joint_names": SURROGATE.byteswap().view(">U1")}, "no text"),
        ({"fps": np.array(b"\xff")}, "no text"),
        ({"fps": NO_CODE[:1]}, "no text"),
        ({"fps": np.array(np.nan)}, "not one finite number"),
        ({"fps": np.array([30, 30])}, "not one finite number"),
        ({"root_pos": SIGNALLING}, "not finite"),
        ({"root_rot": np.zeros((6, 4))}, "no quaternion"),
        ({"dof_pos": np.zeros((6, 3), "c16")}, "floats or whole numbers"),
        ({"dof_pos": np.zeros((6, 3), np.longdouble)}, "floats or whole numbers"),
        ({"dof_pos": saved(np.zeros((6, 3)), "'\\q'")}, "dof_pos"),
        ({"dof_pos": saved(np.zeros((6, 3)), "(" * 5000)}, "dof_pos"),
        ({"dof_pos": saved(np.zeros((6, 3)), "-" * 8000 + "1")}, "dof_pos"),
    ],
)  # fmt: skip
def test_a_robots_archive(
    tmp_path: Path, arrays: dict[str, np.ndarray | bytes | None], said: str
) -> None:
    assert said in refused(archive(tmp_path, "robot_npz", **arrays))


def test_a_body_of_no_joints(tmp_path: Path) -> None:
    nothing = np.zeros((6, 0))
    path = archive(tmp_path, "smpl", poses=None, root_orient=nothing, pose_body=nothing)
    assert "root_orient" in refused(path)


@pytest.mark.parametrize("dtype", ["<f2", ">f2", "<f4", ">f4", ">f8", "<i1", ">i8", "<u2"], ids=str)
@pytest.mark.parametrize("order", ["C", "F"])
def test_other_types_and_orders_are_read(tmp_path: Path, dtype: str, order: str) -> None:
    angles = np.asarray(np.arange(18).reshape(6, 3) % 4, dtype, order=order)  # type: ignore[call-overload]
    clip = read_clip(archive(tmp_path, "robot_npz", dof_pos=angles), REGISTRY)
    turns = clip.rotations[:, 1:].numpy()
    found = 2.0 * np.arctan2(turns[..., 1], turns[..., 0])
    np.testing.assert_allclose(np.cos(found), np.cos(angles.astype(float)), atol=1e-6)


def test_a_large_archive_is_read_once(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Each reader that is asked whether it is its own read all of it, so that a large one took seconds of a busy machine."""
    path = WRITE["robot_npz"](tmp_path)
    with zipfile.ZipFile(path, "a") as file:
        file.writestr("more.npy", bytes(2 * npz.MAX_DIRECTORY))
    wholes: list[Path] = []
    whole = npz.read_bytes
    monkeypatch.setattr(npz, "read_bytes", lambda path: wholes.append(path) or whole(path))
    assert read_clip(path, REGISTRY).num_frames == 6
    assert wholes == [path]


def test_names_are_those_of_the_whole(tmp_path: Path) -> None:
    path = WRITE["robot_npz"](tmp_path)
    with zipfile.ZipFile(path, "a") as file:
        file.comment = b"a comment" * 7000
    assert npz.array_names(path) == npz.Archive(path).names >= {"root_pos", "fps"}
    with zipfile.ZipFile(path, "a") as file:
        for n in range(npz.MAX_MEMBERS):
            file.writestr(f"{n}.npy", b"")
    assert npz.array_names(path) == frozenset()
    with pytest.raises(FileError, match="more than 256 arrays"):
        npz.Archive(path)
    assert npz.array_names(tmp_path) == npz.array_names(tmp_path / "none") == frozenset()
