"""Fault 15: one of two processes of a training is killed, or hangs: the other ends, with a status that
is not 0, within a bound, and ``torchrun`` leaves nobody behind.

What a killed or a hanging worker of a sweep does to it stands in tests/plugins/sweeps/test_executors.py.
"""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from worlds import child_environment

pytest.importorskip("torch.distributed")

#: A training of the line's parts without end, in which each process says who it is.
WORKER = """
import os, sys, counted_task as c
from pathlib import Path
from understudy.setup import plugins, composition
from understudy.command import workflow
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
def test_the_others_end(tmp_path: Path, number: signal.Signals, rank: int) -> None:
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
    finally:
        if parent.poll() is None:
            parent.kill()
            parent.communicate()
