"""Fault 15: one of two processes of a training is killed, or hangs: the other ends, with a status that
is not 0 and one sentence, within a bound, ``torchrun`` leaves nobody behind, and the run can be resumed.

What a killed or a hanging worker of a sweep does to it stands in tests/plugins/sweeps/test_executors.py.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
import torch
from counted_task import install, line_plugins
from worlds import child_environment

from understudy import distributed
from understudy.command.cli import main
from understudy.errors import TrainingError
from understudy.records import checkpoint, runs
from understudy_networks import averages

pytest.importorskip("torch.distributed")

#: A training of the line's parts without end, in which each process says who it is.
WORKER = """
import os, sys, counted_task as c
from pathlib import Path
from understudy.setup import plugins, composition
from understudy_training import workflow
found = c.line_plugins()
for module in (plugins, composition, workflow):
    module.installed = lambda: found
from understudy.command.cli import main
Path("worker" + os.environ["RANK"]).write_text(str(os.getpid()))
sys.exit(main(["train", *c.LINE_TASK, "budget.samples=1000000000", "run.dir=run"]))
"""
#: Seconds that one process waits for the others, here; 1800 unless said.
PATIENCE = 5.0
#: Seconds in which torchrun notices, tells the others to end, and kills those that do not.
BOUND = 60.0


def alive(process: int) -> bool:
    try:
        return Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False


@pytest.mark.parametrize(
    ("number", "rank"),
    [
        (signal.SIGKILL, 1),
        pytest.param(signal.SIGKILL, 0, marks=pytest.mark.slow),
        pytest.param(signal.SIGSTOP, 0, marks=pytest.mark.slow),
        pytest.param(signal.SIGSTOP, 1, marks=pytest.mark.slow),
    ],
)
def test_the_others_end(
    tmp_path: Path, number: signal.Signals, rank: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "worker.py").write_text(WORKER)
    parent = subprocess.Popen(
        [sys.executable, "-m", "torch.distributed.run", "--standalone", "--nproc-per-node=2",
         "worker.py"],
        cwd=tmp_path, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True,
        env=child_environment(
            GLOO_SOCKET_IFNAME="lo", UNDERSTUDY_PATIENCE=str(PATIENCE),
            TORCHELASTIC_EXIT_BARRIER_TIMEOUT="5",
        ),
    )  # fmt: skip
    workers: list[int] = []
    try:
        deadline = time.monotonic() + 90
        while not (tmp_path / "run/metrics.jsonl").exists():
            assert parent.poll() is None, parent.communicate()[1]
            assert time.monotonic() < deadline
            time.sleep(0.05)
        workers = [int((tmp_path / f"worker{n}").read_text()) for n in range(2)]
        os.kill(workers[rank], number)
        began = time.monotonic()
        _, errors = parent.communicate(timeout=BOUND)
        assert parent.returncode != 0
        assert time.monotonic() - began < BOUND
        assert not any(alive(worker) for worker in workers), errors
        told = [line for line in errors.splitlines() if line.startswith("understudy: ")]
        assert len(told) == 1, errors  # of the one that was left
        assert told[0].startswith(("understudy: Another process of", "understudy: Stopped by SIG"))
        assert "raise TrainingError" not in errors
    finally:
        if parent.poll() is None:
            parent.kill()
            for worker in workers:  # which would hold its pipe
                with contextlib.suppress(ProcessLookupError):
                    os.kill(worker, signal.SIGKILL)
            parent.communicate()
    install(monkeypatch, line_plugins())
    run = runs.open_run(tmp_path / "run")
    done = int(checkpoint.newest(run.checkpoints)[0].name)
    samples = run.metrics()[-1]["samples"] + 24
    assert main(["resume", str(run.path), f"budget.samples={samples}"]) == 0
    assert [row["iteration"] for row in run.metrics()] == list(range(1, len(run.metrics()) + 1))
    assert len(run.metrics()) >= done


@pytest.mark.parametrize("call", ["total", "decided", "anyone", "average"])
def test_a_lost_process_is_one_sentence(call: str, monkeypatch: pytest.MonkeyPatch) -> None:
    """Wherever processes meet, whatever the library makes of it."""

    def alone(*_: object) -> None:
        raise RuntimeError("Connection closed by peer [127.0.0.1]:4321\nand more")

    monkeypatch.setattr(distributed, "size", lambda: 2)
    for name in ("all_reduce", "broadcast"):
        monkeypatch.setattr(torch.distributed, name, alone)
    cpu = torch.device("cpu")
    calls = {
        "total": lambda: distributed.total(torch.ones(2)),
        "decided": lambda: distributed.decided(1, cpu),
        "anyone": lambda: distributed.anyone(True, cpu),
        "average": lambda: averages.average(torch.ones(2)),
    }
    with pytest.raises(TrainingError, match=r"Another process .* closed by peer .*4321\)\. What"):
        calls[call]()
