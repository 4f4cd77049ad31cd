"""Fault 12: folders that cannot be written or are missing, and two runs in one, give one clear error."""

from __future__ import annotations

import errno
import os
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from commands import forked
from worlds import CLI, SMALL, child_environment, make_training, resumed

from understudy.command.cli import main
from understudy.errors import RunError
from understudy.folders import write_atomically
from understudy.inputs import Inputs
from understudy.records import checkpoint, runs
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK
from understudy_report.video import write_video
from understudy_training import workflow


@pytest.mark.parametrize("where", ["file/run", "/proc/run"])
def test_impossible_folder(plugins: Plugins, tmp_path: Path, where: str) -> None:
    (tmp_path / "file").write_text("")
    path = tmp_path / where
    with pytest.raises(RunError, match=rf"The run folder {path} cannot be made: .*run\.dir"):
        make_training(plugins, [*FAKE_TASK, *SMALL], path)


def test_a_folder_in_thousands_of_others(plugins: Plugins, tmp_path: Path) -> None:
    where = f"run.dir={tmp_path}/{'d/' * 1500}"
    with pytest.raises(RunError, match=r"^The run folder .{200} cannot be made: .*too deep\. Give"):
        runs.create(load_experiment([*FAKE_TASK, where], plugins), [], {})
    assert not any(tmp_path.iterdir())


def test_folder_that_becomes_unwritable(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.iterate()
    (tmp_path / "run/checkpoints").rmdir()
    with pytest.raises(RunError, match=r"00000001.safetensors could not be written: No such file"):
        training.save()
    (tmp_path / "run/metrics.jsonl").mkdir()
    assert training.run is not None
    with pytest.raises(RunError, match=r"metrics.jsonl could not be written: Is a directory"):
        training.run.append_metrics({})


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write everywhere")
def test_read_only_run(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.save()
    assert training.run is not None
    training.run.unlock()
    for folder in ("run/checkpoints", "run"):
        (tmp_path / folder).chmod(0o500)
    with pytest.raises(RunError, match=r"cannot be written|could not be written"):
        resumed(plugins, tmp_path / "run")


def test_lock_file_cannot_be_made(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    assert training.run is not None
    training.run.unlock()
    (tmp_path / "run/.lock").unlink()
    (tmp_path / "run/.lock").mkdir()
    with pytest.raises(RunError, match=r"run cannot be written: Is a directory"):
        runs.open_run(tmp_path / "run").lock()


def test_missing_folders(tmp_path: Path) -> None:
    with pytest.raises(RunError, match=r"nowhere is no run folder: it has no run\.json"):
        runs.open_run(tmp_path / "nowhere")
    with pytest.raises(RunError, match=r"has no usable checkpoint"):
        checkpoint.load_newest(tmp_path)


def test_second_run_in_a_folder(plugins: Plugins, tmp_path: Path) -> None:
    make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    with pytest.raises(RunError, match=r"already holds a run\. Continue it with"):
        make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")


def test_two_processes_in_one_folder(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    training.save()
    code = CLI + "sys.exit(main(['resume', sys.argv[1]]))"
    done = forked(code, str(tmp_path / "run"), cwd=tmp_path)
    assert done.returncode == 2, done.stderr
    assert "Another process is training in" in done.stderr
    assert "Traceback" not in done.stderr


def test_lock_of_a_killed_process_is_free(plugins: Plugins, tmp_path: Path) -> None:
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    assert training.run is not None
    training.run.unlock()
    holder = subprocess.Popen(
        [sys.executable, "-c", "import fcntl,sys,time; f=open(sys.argv[1],'w'); "
         "fcntl.flock(f, fcntl.LOCK_EX); print(flush=True); time.sleep(60)", str(tmp_path / "run/.lock")],
        stdout=subprocess.PIPE,
    )  # fmt: skip
    assert holder.stdout is not None
    holder.stdout.readline()
    with pytest.raises(RunError, match="Another process"):
        runs.open_run(tmp_path / "run").lock()
    holder.kill()
    holder.wait()
    runs.open_run(tmp_path / "run").lock()


@pytest.mark.parametrize("again", [False, True], ids=["removed", "another's"])
def test_a_folder_that_is_gone_under_a_training(
    plugins: Plugins, tmp_path: Path, again: bool
) -> None:
    """Nothing of it is called intact, and nothing is written into what stands there instead."""
    path = tmp_path / "run"
    training = make_training(plugins, [*FAKE_TASK, *SMALL], path)
    training.save()
    run = training.run
    assert run is not None
    shutil.rmtree(path)
    if again:
        make_training(plugins, [*FAKE_TASK, *SMALL], path).save()
    before = {f: f.read_bytes() for f in path.rglob("*") if f.is_file()}
    row = training.iterate()
    for write in (
        lambda: run.append_metrics(row),
        lambda: run.write_json("evaluation.json", {}),
        lambda: run.keep_metrics_until(0),
        training.save,
    ):
        with pytest.raises(RunError, match="was removed or replaced while") as caught:
            write()
        assert "intact" not in str(caught.value)
    assert {f: f.read_bytes() for f in path.rglob("*") if f.is_file()} == before
    with pytest.raises(RunError, match="was removed or replaced while"):
        training.train()


def test_a_working_folder_that_is_gone(tmp_path: Path) -> None:
    (tmp_path / "gone").mkdir()
    words = 'cd gone && rmdir ../gone && exec "$@"'
    ended = subprocess.run(
        ["sh", "-c", words, "sh", sys.executable, "-m", "understudy", "runs"], cwd=tmp_path, capture_output=True, text=True,
        env=child_environment(),
    )  # fmt: skip
    assert ended.returncode == 2
    assert ended.stderr == (
        "understudy: The working folder is not there any more. Change to another.\n"
    )


@pytest.mark.parametrize("place", [".", "there", "there/."])
def test_a_file_where_a_folder_is(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, place: str
) -> None:
    """As by ``--page .`` and ``--video .``."""
    (tmp_path / "there").mkdir()
    monkeypatch.chdir(tmp_path)
    with pytest.raises(RunError, match="could not be written"):
        write_atomically(Path(place), b"a page")
    with pytest.raises(RunError, match="could not be written"):
        write_video(Path(place), iter([np.zeros((4, 4, 3), np.uint8)]), 10.0)
    assert [p.name for p in tmp_path.rglob("*")] == ["there"]


@pytest.mark.parametrize(
    "words",
    [
        ["evaluate", "NAME"], ["play", "NAME"], ["compare", "NAME", "NAME"], ["cite", "NAME"], ["render", "NAME"],
        ["licence", "NAME", "--for", "commercial"], ["export", "NAME", "walk.glb"], ["export", "spacetime/walk", "NAME.html"],
        ["motion", "check", "NAME"], ["describe", "NAME"], ["runs", "NAME"], ["train", "motion.file=NAME"], ["-NAME"],
        ["train", "<NAME>"],
    ],
    ids=" ".join,
)  # fmt: skip
def test_a_name_that_no_file_can_have_ends_in_a_line(
    words: list[str],
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main([word.replace("NAME", 300 * "a" + ".x") for word in words]) == 2
    said = capsys.readouterr().err
    assert said.count("understudy: ") == 1
    assert "Traceback" not in said
    assert not any(tmp_path.iterdir())


def test_a_folder_that_may_not_be_entered_ends_in_a_line(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    stat = os.stat

    def forbidden(path: Any, **how: Any) -> os.stat_result:
        if str(path).startswith("/private"):
            raise PermissionError(errno.EACCES, "Permission denied", str(path))
        return stat(path, **how)

    monkeypatch.setattr(os, "stat", forbidden)
    assert main(["evaluate", "/private/run"]) == 2
    assert "cannot be used: Permission denied." in capsys.readouterr().err


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_a_pipe_or_a_device_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    """As by ``--page /dev/null``, which would be a file then, for everybody on the machine."""
    pipe = tmp_path / "page.html"
    os.mkfifo(pipe)
    assert main(["export", "spacetime/walk", str(pipe), *more]) == 2
    assert capsys.readouterr().err == f"understudy: {pipe} is there already. Name another file.\n"
    assert pipe.is_fifo()


@pytest.mark.parametrize("more", [[], ["--overwrite"]])
def test_a_link_to_what_is_not_there_now_is_not_replaced(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str]
) -> None:
    """As to a disk that is not mounted: the link was taken for nothing, and a file stood in its place."""
    link = tmp_path / "page.html"
    link.symlink_to(tmp_path / "elsewhere/page.html")
    assert main(["export", "spacetime/walk", str(link), *more]) == 2
    assert capsys.readouterr().err == f"understudy: {link} is there already. Name another file.\n"
    assert link.is_symlink()


def test_no_folder_for_temporary_files(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """As in a container whose file system is read-only: one line, whatever wanted it."""
    monkeypatch.setattr("tempfile.tempdir", None)
    monkeypatch.setattr("tempfile._candidate_tempdir_list", lambda: ["/proc/nowhere"])
    monkeypatch.setattr(workflow, "train", lambda words: tempfile.mkdtemp())
    assert main(["train", "seed=1"]) == 2
    said = "understudy: No folder for temporary files is writable: set TMPDIR to one.\n"
    assert capsys.readouterr().err == said


def test_another_file_that_is_missing_is_no_temporary_folder(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It is a defect, and keeps its traceback, whatever it is called."""
    monkeypatch.setattr("tempfile.tempdir", None)
    name = "temporary directory"
    monkeypatch.setattr(workflow, "train", lambda words: Path(name).read_text())
    with pytest.raises(FileNotFoundError):
        main(["train", "seed=1"])


@pytest.mark.parametrize("why", ["ENOSPC", "EDQUOT", "EFBIG", "EROFS", "EACCES", "ELOOP"])
def test_a_temporary_file_that_cannot_be_written_ends_in_a_line(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], why: str
) -> None:
    """As where ``/tmp`` is full, or became read-only: whoever wanted it need not think of that."""
    number = getattr(errno, why)

    def full(*_: object) -> None:
        raise OSError(number, os.strerror(number), "/tmp/of-a-library")

    monkeypatch.setattr(workflow, "train", full)
    assert main(["train", "seed=1"]) == 2
    said = f"understudy: /tmp/of-a-library cannot be used: {os.strerror(number)}.\n"
    assert capsys.readouterr().err == said


@pytest.mark.parametrize("fails", ["run.json", "inputs"])
@pytest.mark.parametrize("there", ["nothing", "an empty folder", "notes of the user's"])
@pytest.mark.parametrize("named", [True, False])
def test_no_folder_is_left_of_a_run_that_could_not_be_made(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, fails: str, there: str, named: bool,
) -> None:  # fmt: skip
    """As where ``run.json`` does not fit on the disk any more; what is somebody's own stays."""
    monkeypatch.chdir(tmp_path)
    run = tmp_path / "run" if named else tmp_path / "runs"
    if there != "nothing" and named:
        run.mkdir()
    if there.startswith("notes"):
        (tmp_path / "notes.txt").write_text("mine")
        (run if named else tmp_path).joinpath("notes.txt").write_text("mine")
    before = {p: p.is_file() and p.read_bytes() for p in tmp_path.rglob("*")}
    full = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    def raising(*_: object, **__: object) -> None:
        raise full

    owner, name = (os, "replace") if fails == "run.json" else (Inputs, "copy")
    monkeypatch.setattr(owner, name, raising)
    where = [f"run.dir={run}"] if named else []
    with pytest.raises(RunError, match="No space left on device"):
        runs.create(load_experiment([*FAKE_TASK, *where], plugins), [], {})
    after = {p: p.is_file() and p.read_bytes() for p in tmp_path.rglob("*")}
    left = set(after) - set(before)
    assert not any(p.is_file() and p.name != ".lock" for p in left)
    if there.startswith("notes") and named:
        assert after.items() >= before.items()
    else:
        assert {p.relative_to(tmp_path).as_posix() for p in left} <= {"runs"}, "its folder is gone"


OTHERS = ("metrics.jsonl", "checkpoints/00000003.json", "faults/x.json", "evaluation.json", "report.html",
          "video.mp4", "walk-001/run.json", "tensorboard/events", "src/code.py")  # fmt: skip


@pytest.mark.parametrize("left", OTHERS)
def test_no_training_is_mixed_with_other_things(
    plugins: Plugins, tmp_path: Path, left: str
) -> None:
    """As where ``run.json`` alone was taken away, or in ``runs/`` itself: rows would be appended, a resumed training go on
    from another's checkpoint, a page be overwritten, and the runs below be listed no more."""
    file = tmp_path / "run" / left
    file.parent.mkdir(parents=True)
    file.write_text("{}")
    with pytest.raises(RunError, match=rf"run is not new: it holds {left}, .*run\.dir a folder"):
        runs.create(load_experiment([*FAKE_TASK, f"run.dir={tmp_path / 'run'}"], plugins), [], {})
    assert [p for p in (tmp_path / "run").rglob("*") if p.is_file()] == [file]


def test_a_folder_that_holds_things_is_refused_before_anything_is_built(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """Building may take minutes, as where a garment settles."""
    (tmp_path / "report.html").write_text("mine")
    monkeypatch.setattr(workflow, "Training", lambda *_: pytest.fail("it is built first"))
    assert main(["train", "experiment=miniature/go", f"run.dir={tmp_path}"]) == 2
    assert "is not new: it holds report.html" in capsys.readouterr().err
    long = "x" * 300
    monkeypatch.undo()
    assert main(["train", "experiment=miniature/go", f"run.dir={tmp_path / long}"]) == 2
    assert "cannot be made: File name too long" in capsys.readouterr().err


def test_a_run_begins_beside_notes_and_what_a_killed_one_left(
    plugins: Plugins, tmp_path: Path
) -> None:
    """A log that a shell opened, a hidden file, and the folders of a run that was killed before it was whole."""
    run = tmp_path / "run"
    for name in ("log.txt", "job.sh", ".notes/x", ".lock", "inputs/walk.bvh"):
        (run / name).parent.mkdir(parents=True, exist_ok=True)
        (run / name).write_text("mine")
    (run / "checkpoints").mkdir()
    runs.create(load_experiment([*FAKE_TASK, f"run.dir={run}"], plugins), [], {}).unlock()
    assert (run / "log.txt").read_text() == "mine"


@pytest.mark.parametrize("what", ["a file", "a link to nothing"])
def test_where_runs_are_no_run_can_be_made(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, what: str
) -> None:
    """``runs`` is not full then: a link to nothing was tried a hundred thousand times, and called that."""
    monkeypatch.chdir(tmp_path)
    if what == "a file":
        Path("runs").write_text("mine")
    else:
        Path("runs").symlink_to("nowhere")
    with pytest.raises(RunError, match=r"The run folder runs cannot be made: File exists\."):
        runs.create(load_experiment([*FAKE_TASK, *SMALL], plugins), [], {})
    assert os.listdir() == ["runs"]


@pytest.mark.parametrize("inner", ["inner", "checkpoints", "checkpoints/deep/inner"])
@pytest.mark.parametrize("linked", [False, True])
def test_no_run_begins_inside_another(
    plugins: Plugins, tmp_path: Path, inner: str, linked: bool
) -> None:
    """`understudy runs` would not list it, and what is in ``checkpoints`` is the outer run's to delete."""
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    assert training.run is not None
    training.run.unlock()
    (tmp_path / "link").symlink_to("run")
    before = sorted(tmp_path.rglob("*"))
    path = tmp_path / ("link" if linked else "run") / inner
    with pytest.raises(RunError, match=rf"is inside the run {tmp_path / 'run'}\. Give run\.dir"):
        make_training(plugins, [*FAKE_TASK, *SMALL], path)
    assert sorted(tmp_path.rglob("*")) == before


def test_a_run_in_the_root_of_the_disk_is_refused_at_once(
    plugins: Plugins, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Not after a look through all that is on it."""
    monkeypatch.setattr(runs, "check_within", lambda folder: pytest.fail("looks through it"))
    with pytest.raises(RunError, match=r"^/ is not new: it holds "):
        make_training(plugins, [*FAKE_TASK, *SMALL], Path("/"))
