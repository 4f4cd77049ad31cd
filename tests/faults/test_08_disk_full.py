"""Fault 8: the disk is full during a checkpoint, a log row or a dump; the old checkpoint is intact."""

from __future__ import annotations

import errno
import os
import resource
import signal
import subprocess
import sys
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import torch
from commands import forked
from worlds import CLI, SMALL, child_environment, make_training, resumed

from understudy.errors import RunError
from understudy.records import checkpoint
from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy.running.training import Reporter
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK


@pytest.fixture
def small_disk(tmp_path: Path) -> Iterator[Path]:
    """A file system of 1 MB, where this may be mounted."""
    path = tmp_path / "disk"
    path.mkdir()
    if subprocess.run(
        ["mount", "-t", "tmpfs", "-o", "size=1M", "tmpfs", path], capture_output=True
    ).returncode:
        pytest.skip("may not mount a small file system here")
    yield path
    subprocess.run(["umount", "-l", path], check=True)


def state(n: float, size: int = 50_000) -> dict[str, torch.Tensor]:
    return {"x": torch.full((size,), float(n))}


def test_full_file_system(small_disk: Path) -> None:
    for n in range(3):
        checkpoint.save(small_disk / f"{n:08d}", state(n), {})
    with pytest.raises(  # noqa: PT012
        RunError, match=r"00000003.safetensors could not be written: No space left on device"
    ):
        for n in range(3, 10):
            checkpoint.save(small_disk / f"{n:08d}", state(n, 150_000), {})
    assert not list(small_disk.glob(".*.partial")), "nothing half-written keeps the disk full"
    with pytest.raises(RunError):
        checkpoint.save(small_disk / "00000002", state(9, 200_000), {})
    loaded, _, path = checkpoint.load_newest(small_disk)
    assert path.name == "00000002"
    assert torch.equal(loaded["x"], state(2)["x"])


def test_write_cut_short(tmp_path: Path) -> None:
    """Without mounting: the kernel refuses to write on, in the middle of the file."""
    checkpoint.save(tmp_path / "00000001", state(1), {})
    signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (100_000, hard))
    try:
        for name in ("00000001", "00000002"):
            with pytest.raises(RunError, match="could not be written: File too large"):
                checkpoint.save(tmp_path / name, state(2), {})
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))
    loaded, _, path = checkpoint.load_newest(tmp_path)
    assert path.name == "00000001"
    assert torch.equal(loaded["x"], state(1)["x"])
    assert sorted(p.name for p in tmp_path.glob("0*")) == ["00000001.json", "00000001.safetensors"]
    assert not list(tmp_path.glob(".*"))


@pytest.mark.parametrize("call", ["fsync", "replace"])
def test_late_failures(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, call: str) -> None:
    """Some file systems notice only when flushing, or at the rename."""
    checkpoint.save(tmp_path / "00000001", state(1), {})

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    with monkeypatch.context() as patch:
        patch.setattr(os, call, full)
        with pytest.raises(RunError, match="No space left on device"):
            checkpoint.save(tmp_path / "00000001", state(2), {})
    loaded, _ = checkpoint.load(tmp_path / "00000001")
    assert torch.equal(loaded["x"], state(1)["x"])


def test_command_ends_with_status_2_and_resumes(plugins: Plugins, tmp_path: Path) -> None:
    """A training whose metrics, then checkpoints, no longer fit: one line, exit status 2."""
    limit = """
import resource, signal
signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
resource.setrlimit(resource.RLIMIT_FSIZE, (40_000, 40_000))
"""
    overrides = [*FAKE_TASK, *SMALL, "budget.samples=100000", f"run.dir={tmp_path / 'run'}"]
    done = forked(
        CLI + limit + "sys.exit(main(['train', *sys.argv[1:]]))", *overrides, cwd=tmp_path
    )
    assert done.returncode == 2, done.stderr
    last = done.stderr.strip().splitlines()[-1]
    assert last.startswith("understudy: ")
    assert "could not be written: File too large" in last
    training = resumed(plugins, tmp_path / "run", more=["budget.samples=2000"])
    assert training.progress.iteration == 0
    training.train()


def test_fault_dump_does_not_fit(
    plugins: Plugins, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The run goes on without the dump, and says so."""
    training = make_training(plugins, [*FAKE_TASK, *SMALL], tmp_path / "run")
    messages: list[str] = []
    training.reporter.message = messages.append
    training.job.environment.reset()

    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(os, "fsync", full)
    step = training.job.environment.step(torch.full((16, 1), float("nan")))
    assert step.failed.all()
    assert "No space left on device" in messages[0]


def test_a_log_that_cannot_be_written_is_left_out(plugins: Plugins, tmp_path: Path) -> None:
    class Log(RunObserver):
        calls = 0

        def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
            self.calls += 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    messages: list[str] = []
    reporter = Reporter(message=messages.append, observers=[log := Log()])
    training = make_training(
        plugins, [*FAKE_TASK, *SMALL, "budget.samples=500"], tmp_path / "run", reporter
    )
    assert training.train() == "budget"
    assert log.calls == 1
    assert messages == ["The observer Log is left out: OSError: [Errno 28] No space left on device"]


@pytest.mark.parametrize("unbuffered", ["", "1"])
@pytest.mark.parametrize("words", ["runs .", "describe learner/ppo"])
def test_what_is_printed_onto_a_full_disk(tmp_path: Path, words: str, unbuffered: str) -> None:
    """As by ``understudy cite RUN > refs.bib``: one line that says so, and status 2."""
    with Path("/dev/full").open("w") as full:
        ended = subprocess.run(
            [sys.executable, "-m", "understudy", *words.split()], cwd=tmp_path, stdout=full, stderr=subprocess.PIPE, text=True,
            env={**child_environment(), "PYTHONUNBUFFERED": unbuffered},
        )  # fmt: skip
    assert ended.returncode == 2
    said = "understudy: What is printed cannot be written: No space left on device.\n"
    assert ended.stderr == said


@pytest.mark.parametrize("unbuffered", ["", "1"])
def test_what_is_printed_on_a_terminal_that_is_gone(tmp_path: Path, unbuffered: str) -> None:
    """As by a session that was closed: it was a traceback, in the log of errors."""
    ours, theirs = os.openpty()
    os.close(ours)
    ended = subprocess.run(
        [sys.executable, "-m", "understudy", "runs", "."], cwd=tmp_path, stdout=theirs, stderr=subprocess.PIPE, text=True,
        env={**child_environment(), "PYTHONUNBUFFERED": unbuffered},
    )  # fmt: skip
    os.close(theirs)
    said = "understudy: What is printed cannot be written: Input/output error.\n"
    assert (ended.returncode, ended.stderr) == (2, said)


def test_what_is_printed_where_nothing_may_be_written(tmp_path: Path) -> None:
    with Path(os.devnull).open() as readable:
        ended = subprocess.run(
            [sys.executable, "-m", "understudy", "runs", "."], cwd=tmp_path, stdout=readable, stderr=subprocess.PIPE,
            text=True, env=child_environment(),
        )  # fmt: skip
    assert (ended.returncode, ended.stderr) == (
        2,
        "understudy: What is printed cannot be written: Bad file descriptor.\n",
    )
