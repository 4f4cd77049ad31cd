"""Writing by ending, all or nothing."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch
from motion_files import walker

import understudy_motion
from understudy.errors import FileError
from understudy.setup.registry import Registrar, Registry
from understudy_motion.clip import Clip
from understudy_motion.reading import read_clip
from understudy_motion.writing import ClipWriter, Shape, write_clip


@pytest.fixture(scope="module")
def registry() -> Registry:
    made = Registry()
    Registrar(made, "motion").tables(understudy_motion)
    return made


@pytest.mark.parametrize("ending", ["bvh", "csv", "npz", "NPZ"])
def test_what_is_written_is_read(tmp_path: Path, registry: Registry, ending: str) -> None:
    path = tmp_path / f"walker.{ending}"
    write_clip(walker(), path, registry)
    torch.testing.assert_close(
        read_clip(path, registry).root_position, walker().root_position, rtol=0, atol=1e-9
    )
    assert list(tmp_path.iterdir()) == [path]


@pytest.mark.parametrize(
    ("source", "said"),
    [
        ("/home/ann/my clips/walk.bvh", "walk.bvh"),
        (r"C:\Users\ann\walk.bvh", "walk.bvh"),
        ("~/walk.bvh", "walk.bvh"),
        ("../ann/run/", "run"),
        ("clips/walk.bvh", "clips/walk.bvh"),
        ("generated", "generated"),
        ("/", "/"),
        ("", ""),
    ],
)
def test_what_others_get_names_no_folder_of_whoever_wrote_it(
    tmp_path: Path, registry: Registry, source: str, said: str
) -> None:
    write_clip(replace(walker(), source=source), tmp_path / "a.npz", registry)
    with np.load(tmp_path / "a.npz", allow_pickle=False) as found:
        assert str(found["source"]) == said


def test_other_endings_are_refused(tmp_path: Path, registry: Registry) -> None:
    with pytest.raises(FileError, match=r"no format is written to '\.xyz'.*\.bvh, \.csv, \.npz"):
        write_clip(walker(), tmp_path / "walker.xyz", registry)
    with pytest.raises(FileError, match="cannot be written"):
        write_clip(walker(), tmp_path / "absent" / "walker.npz", registry)


def test_a_runs_own_recording_is_not_replaced(tmp_path: Path, registry: Registry) -> None:
    """`motion check RUN --fix RUN/recording.npz --overwrite` did, and nothing was made of the run any more."""
    write_clip(walker(), tmp_path / "recording.npz", registry)
    (tmp_path / "run.json").touch()
    before = (tmp_path / "recording.npz").read_bytes()
    with pytest.raises(FileError, match="that is the run's own recording"):
        write_clip(walker(), tmp_path / "recording.npz", registry)
    write_clip(walker(), tmp_path / "walk.npz", registry)
    assert (tmp_path / "recording.npz").read_bytes() == before


def test_a_failure_leaves_the_old_file(tmp_path: Path, registry: Registry) -> None:
    path = tmp_path / "walker.bvh"
    path.write_text("old")
    with pytest.raises(FileError, match="has no skeleton"):
        write_clip(replace(walker(), skeleton=None), path, registry)
    assert path.read_text() == "old"
    assert list(tmp_path.iterdir()) == [path]


def test_errors_name_the_file_that_was_asked_for(tmp_path: Path, registry: Registry) -> None:
    class Refusing(ClipWriter):
        suffix = ".no"

        def write(self, clip: Clip, path: Path, shapes: Sequence[Shape] = ()) -> None:
            raise FileError(f"Clip {path}: it cannot be held.")

    Registrar(registry, "test").component("clip_writer", "no", Refusing)
    for name, reason in (
        ("a.no", "it cannot be held"),
        ("nowhere/a.npz", "cannot be written: No such"),
    ):
        with pytest.raises(FileError, match=reason) as caught:
            write_clip(walker(), tmp_path / name, registry)
        assert str(caught.value).startswith(f"Clip {tmp_path / name}: ")
        assert "writing-" not in str(caught.value)
