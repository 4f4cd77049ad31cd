"""Fault 24: a file without end, or of 40 GB of nothing, costs one sentence and no memory, wherever a run,
a sweep or a skill is read."""

from __future__ import annotations

import json
import os
import shutil
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace
from typing import cast

import pytest
from worlds import SMALL, little_memory, make_training

from understudy.command.cli import main
from understudy.errors import RunError, UnderstudyError
from understudy.folders import read
from understudy.inputs import Inputs
from understudy.records import checkpoint, runs
from understudy.setup.plugins import Plugins
from understudy.task import Context
from understudy.testing.fake import FAKE_TASK
from understudy_mujoco.scene import MjcfFile
from understudy_report.motion import VIDEO, Motion
from understudy_sitting import trials
from understudy_sweeps.film import shows
from understudy_sweeps.journal import Journal

HUGE = 40 * 2**30
HALF = 6 * 10**8  #: what some training's file might have, and there is no room for here


@pytest.fixture(autouse=True)
def _little_memory() -> Iterator[None]:
    """Half a GB more than now."""
    with little_memory():
        yield


@pytest.fixture
def run(plugins: Plugins, tmp_path: Path) -> Path:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.iterate()
    training.save()
    assert training.run is not None
    training.run.append_metrics({"iteration": 1, "samples": 128})
    training.run.unlock()
    return tmp_path / "run"


def nothing(path: Path) -> None:
    path.unlink(missing_ok=True)
    path.touch()
    os.truncate(path, HUGE)


@pytest.mark.parametrize("name", ["metrics.jsonl", "run.json"])
def test_a_run_of_nothing(run: Path, name: str) -> None:
    nothing(run / name)
    with pytest.raises(RunError, match=rf"{name} cannot be read: it is larger than \d+ MiB"):
        runs.open_run(run).metrics()


def test_a_row_without_end(run: Path) -> None:
    """It is left out, and what comes after it is read."""
    rows = (run / "metrics.jsonl").read_bytes()
    (run / "metrics.jsonl").write_bytes(rows + b'{"x": "' + b" " * 2**22 + b'"}\n' + rows)
    assert [row["samples"] for row in runs.open_run(run).metrics()] == [128, 128]


@pytest.mark.parametrize("ending", ["json", "safetensors"])
def test_a_checkpoint_of_nothing(run: Path, ending: str) -> None:
    nothing(run / "checkpoints" / f"00000001.{ending}")
    with pytest.raises(RunError, match="cannot be read: it is larger than"):
        checkpoint.load_newest(run / "checkpoints")


def test_tensors_that_are_not_what_was_saved_take_no_room(run: Path) -> None:
    """Nor is there memory for them."""
    path = run / "checkpoints" / "00000001.safetensors"
    nothing(path)
    os.truncate(path, HALF)
    with pytest.raises(RunError, match="its digest does not match"):
        checkpoint.load(path)


@pytest.mark.parametrize("ending", ["json", "safetensors"])
@pytest.mark.parametrize("what", ["/dev/zero", "pipe"])
def test_a_checkpoint_that_is_no_file(run: Path, ending: str, what: str) -> None:
    file = run / "checkpoints" / f"00000001.{ending}"
    file.unlink()
    if what == "pipe":
        os.mkfifo(file)
    else:
        file.symlink_to(what)
    with pytest.raises(RunError, match="cannot be read: it is no file"):
        checkpoint.load(file)
    assert main(["resume", str(run)]) == 2


def test_metrics_that_are_a_pipe(run: Path) -> None:
    opened = runs.open_run(run)
    (run / "metrics.jsonl").unlink()
    os.mkfifo(run / "metrics.jsonl")
    with pytest.raises(RunError, match=r"metrics\.jsonl cannot be read: it is no file"):
        opened.metrics()


def test_a_journal_of_nothing(tmp_path: Path) -> None:
    nothing(tmp_path / "journal.jsonl")
    with pytest.raises(RunError, match="cannot be read: it is larger than"):
        Journal.read(tmp_path / "journal.jsonl")


def test_inputs_of_nothing(tmp_path: Path) -> None:
    nothing(tmp_path / "clip.npz")
    kept = Inputs(tmp_path, {"the clip": {"clip.npz": "0" * 64}})
    with pytest.raises(UnderstudyError, match="it is larger than"):
        kept.file("the clip", list)
    os.truncate(tmp_path / "clip.npz", HALF)
    with pytest.raises(UnderstudyError, match="not what the run was made with"):
        kept.file("the clip", list)
    (tmp_path / "clip.npz").unlink()
    os.mkfifo(tmp_path / "clip.npz")
    with pytest.raises(UnderstudyError, match="not what the run was made with"):
        kept.file("the clip", list)


def test_films_of_nothing(run: Path) -> None:
    """They are left out, or drawn anew."""
    for name in (VIDEO, "trials_1.mp4", "film.mp4"):
        nothing(run / name)
    opened = runs.open_run(run)
    assert Motion().html(opened) is None
    assert trials._film(opened, {"file": "trials_1.mp4", "title": "a"}) == ""  # pyright: ignore[reportPrivateUsage]
    (run / "film.json").write_text("[]")
    assert not shows(run / "film.mp4", [])
    (run / "film.mp4").write_bytes(b"a film")
    assert shows(run / "film.mp4", [])
    nothing(run / "film.json")
    assert not shows(run / "film.mp4", [])


def test_a_licence_of_nothing(tmp_path: Path) -> None:
    """As much of it is kept as of a licence."""
    (tmp_path / "a.xml").write_text("<mujoco><worldbody><geom size='1'/></worldbody></mujoco>")
    nothing(tmp_path / "LICENSE")
    inputs = Inputs(tmp_path / "none", {})
    MjcfFile(
        MjcfFile.Options(str(tmp_path / "a.xml")), cast("Context", SimpleNamespace(inputs=inputs))
    )
    inputs.copy(tmp_path / "kept")
    assert 0 < next((tmp_path / "kept").rglob("LICENSE")).stat().st_size < 2**21


def test_other_files_of_nothing(run: Path) -> None:
    """What is for show is left out."""
    nothing(run / "evaluation.json")
    copy = shutil.copy(run / "metrics.jsonl", run / "copy")
    assert json.loads(read(Path(copy)).splitlines()[0])["samples"] == 128
    with pytest.raises(OSError, match="larger than"):
        read(run / "evaluation.json")
