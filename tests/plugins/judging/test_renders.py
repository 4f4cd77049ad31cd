"""``understudy render`` and ``evaluate`` where the run's folder cannot be written."""

from __future__ import annotations

import json
from pathlib import Path

import miniatures
import pytest

from understudy.command.cli import main
from understudy.errors import RunError
from understudy.records.runs import Run
from understudy_judging import commands


def test_nothing_is_left_of_what_could_not_be_written(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "experiment=miniature/go", "budget.samples=256", *miniatures.QUICK
    miniatures.train(*words, f"run.dir={tmp_path}/run", "run.video_seconds=0")
    before = sorted(tmp_path.rglob("*"))

    def fails(path: Path, *_: object) -> None:
        raise RunError(f"{path} could not be written: No space left on device.")

    monkeypatch.setattr(commands.checkpoint, "save", fails)
    assert main(["render", f"{tmp_path}/run", "seconds=1"]) == 2
    assert "No space left on device" in capsys.readouterr().err
    assert sorted(tmp_path.rglob("*")) == before


def test_a_result_that_cannot_be_kept_is_printed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As of a run of somebody else's, whose folder may only be read."""
    words = "experiment=miniature/go", "budget.samples=256", *miniatures.QUICK
    miniatures.train(*words, f"run.dir={tmp_path}/run", "run.video_seconds=0")

    def fails(self: Run, name: str, value: object) -> None:
        raise RunError(f"{self.path / name} could not be written: Read-only file system.")

    monkeypatch.setattr(Run, "write_json", fails)
    capsys.readouterr()
    assert main(["evaluate", f"{tmp_path}/run", "episodes=2"]) == 2
    said = capsys.readouterr()
    assert json.loads(said.out)["episodes"] == 2
    assert "Read-only file system" in said.err


def test_a_run_trained_without_a_film_gets_one(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = "experiment=miniature/go", "budget.samples=256", *miniatures.QUICK
    miniatures.train(*words, f"run.dir={tmp_path}/run", "run.video_seconds=0")
    recording = tmp_path / "run" / "recording.npz"
    assert not recording.exists()
    assert main(["render", f"{tmp_path}/run", "run.video_seconds=0", "episodes=2"]) == 0
    assert not list(tmp_path.rglob("recording.npz")), "none was asked for"
    assert main(["render", f"{tmp_path}/run"]) == 0
    assert recording.exists()
