"""Fault 22: a stranger's run, sweep or reproduction of which a part leads out of its folder is refused,
before anything is opened for writing; what it leads to stays as it was."""

from __future__ import annotations

import os
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import pytest

from understudy.command.cli import main
from understudy.errors import RunError
from understudy.folders import check_within, open_lock
from understudy.records import runs

SMALL = ("budget.samples=200", "run.video_seconds=0", "evaluation.criterion=null")


@pytest.fixture(scope="session")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("links") / "run"
    assert main(["train", "experiment=miniature/go", f"run.dir={path}", *SMALL]) == 0
    return path


@pytest.fixture
def run(finished: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(finished, tmp_path / "run"))


@pytest.fixture
def away(tmp_path: Path) -> Path:
    """What must stay as it is: a folder of files that a run would write, empty or delete."""
    away = tmp_path / "away"
    (away / "folder").mkdir(parents=True)
    for name in ("file", "folder/00000001.safetensors", "folder/weights.safetensors"):
        (away / name).write_text("precious")
    return away


def content(folder: Path) -> dict[str, str]:
    found = (f for f in sorted(folder.rglob("*")) if f.is_file())
    return {f.relative_to(folder).as_posix(): f.read_text() for f in found}


FILES = (".lock", "metrics.jsonl", "run.json", "evaluation.json", "recording.npz", "report.html",
         "video.mp4", "checkpoints/00000001.safetensors", ".run.json.1.partial", "anything")  # fmt: skip
FOLDERS = ("checkpoints", "tensorboard", "faults", "inputs", "renders", "renders/more")


@pytest.mark.parametrize("part", [*FILES, *FOLDERS])
@pytest.mark.parametrize("relative", [True, False])
def test_a_part_that_leads_out_is_refused(run: Path, away: Path, part: str, relative: bool) -> None:
    target = away / ("folder" if part in FOLDERS else "file")
    link = run / part
    if link.is_dir():
        shutil.rmtree(link)
    link.unlink(missing_ok=True)
    link.parent.mkdir(exist_ok=True)
    link.symlink_to(os.path.relpath(target, link.parent) if relative else target)
    before = content(away)
    with pytest.raises(RunError, match=f"{link} is a link that leads out of {run}"):
        runs.open_run(run)
    assert main(["resume", str(run), "budget.samples=300"]) == 2
    assert content(away) == before


@pytest.mark.parametrize("command", ["resume", "evaluate", "render", "export", "play"])
def test_by_every_command(
    run: Path, away: Path, command: str, capsys: pytest.CaptureFixture[str]
) -> None:
    (run / "more").symlink_to(away / "folder")
    words = [str(run), "out.glb"] if command == "export" else [str(run)]
    before = content(away)
    assert main([command, *words]) == 2
    assert "is a link that leads out of" in capsys.readouterr().err
    assert content(away) == before


def test_a_link_to_nothing_leads_out_too(run: Path, tmp_path: Path) -> None:
    (run / "video.mp4").symlink_to(tmp_path / "new")
    with pytest.raises(RunError, match="leads out"):
        runs.open_run(run)


def test_links_that_stay_inside_are_taken(run: Path) -> None:
    (run / "latest").symlink_to("checkpoints")
    (run / "loop").symlink_to("loop")
    assert runs.open_run(run).config


def test_a_run_may_be_reached_by_a_link(run: Path, tmp_path: Path) -> None:
    (tmp_path / "latest").symlink_to(run)
    runs.open_run(tmp_path / "latest").lock()


@pytest.mark.parametrize("make", [os.mkfifo], ids=["pipe"])
def test_pipes_are_refused(run: Path, make: Callable[[Path], None]) -> None:
    make(run / "anything")
    with pytest.raises(RunError, match="anything is neither file nor folder"):
        runs.open_run(run)


def test_a_folder_of_any_depth(tmp_path: Path) -> None:
    folder = tmp_path / "deep"
    folder.mkdir()
    here = os.open(folder, os.O_RDONLY)
    for _ in range(1500):  # more than Python would nest, and than a path may have
        os.mkdir("d", dir_fd=here)
        below = os.open("d", os.O_RDONLY, dir_fd=here)
        os.close(here)
        here = below
    os.close(here)
    try:
        check_within(folder)
    finally:
        subprocess.run(["rm", "-rf", str(folder)], check=True)  # as pytest could not


def test_new_runs_sweeps_and_reproductions(
    tmp_path: Path, away: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """A folder without a run in it is prepared; one that holds things is refused for that already."""
    before = content(away)
    said = {"checkpoints": "is not new: it holds checkpoints/00000001.safetensors"}
    folder = tmp_path / "given"
    folder.mkdir()
    for name, target in ((".lock", "file"), ("checkpoints", "folder"), ("journal.jsonl", "file")):
        (folder / name).symlink_to(away / target)
        for command in (
            ["train", "experiment=miniature/go"],
            ["sweep", "ablation=miniature/jumping", "outer_loop.seeds=[0]"],
            ["reproduce", "spacetime/table_3_1"],
            ["reproduce", "spacetime/table_3_1", "--card"],
        ):
            assert main([*command, f"run.dir={folder}"]) == 2, (name, command)
            assert said.get(name, "leads out of") in capsys.readouterr().err
        (folder / name).unlink()
    assert content(away) == before
    assert not list(folder.iterdir())


def test_a_trial_whose_folder_is_elsewhere(tmp_path: Path, away: Path) -> None:
    sweep = tmp_path / "sweep"
    sweep.mkdir()
    (sweep / "plain-0").symlink_to(away / "folder")
    before = content(away)
    words = ["ablation=miniature/jumping", "outer_loop.seeds=[0]", f"run.dir={sweep}"]
    assert main(["sweep", *words]) == 2
    assert content(away) == before


def test_a_lock_empties_nothing_and_follows_nothing(tmp_path: Path) -> None:
    (tmp_path / "lock").write_text("kept")
    open_lock(tmp_path / "lock").close()
    assert (tmp_path / "lock").read_text() == "kept"
    (tmp_path / "link").symlink_to("lock")
    with pytest.raises(OSError, match="symbolic links"):
        open_lock(tmp_path / "link")
