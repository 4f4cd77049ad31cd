"""Executors of this machine give the same results, whatever happens to their processes."""

from __future__ import annotations

import functools
import os
import signal
import subprocess
import sys
import threading
import time
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import Any

import executors
import pytest
import torch
from commands import begin, forked, kill
from executors import ENDLESS, SMALL_STOP, iterations, make, work
from worlds import child_environment

from understudy.errors import ConfigError, RunError
from understudy.records.runs import Run, open_run
from understudy.setup.composition import load_experiment
from understudy_sweeps import pool, trial
from understudy_sweeps.loops import Executor, Report, Trial, Work
from understudy_sweeps.pool import Host
from understudy_sweeps.processes import OUTPUT
from understudy_sweeps.trial import folder_of

pytestmark = pytest.mark.timeout(200)
Build = Callable[[Work], Executor]


def built(name: str, **options: object) -> Build:
    """With as many threads of torch as the tests' own process has."""
    more = {} if name == "in_process" else {"threads": 1}
    return functools.partial(make, name, **more, **options)


BOTH = pytest.mark.parametrize(
    "build", [built("in_process"), built("processes", workers=2)], ids=["in_process", "processes"]
)


def test_same_results(tmp_path: Path) -> None:
    executors.check_same_results(built("processes", workers=2), tmp_path)


@BOTH
def test_a_failure_is_a_report(build: Build, tmp_path: Path) -> None:
    executors.check_failure_is_a_report(build, tmp_path)


@BOTH
def test_resumes(build: Build, tmp_path: Path) -> None:
    executors.check_resumes(build, tmp_path)


def test_a_killed_process_is_replaced(tmp_path: Path) -> None:
    executors.check_killed_worker_is_replaced(built("processes"), tmp_path)


def test_gives_up(tmp_path: Path) -> None:
    executors.check_gives_up(built("processes", retries=1), tmp_path)


def test_time_limit(tmp_path: Path) -> None:
    executors.check_time_limit(built("processes", retries=1, seconds=2), tmp_path, 2)


def test_a_process_that_hangs(tmp_path: Path) -> None:
    executors.check_hanging(built("processes", seconds=10, grace=1), tmp_path)


def test_what_a_trial_says_is_in_its_folder(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    executors.carry_out(built("processes")(work(tmp_path)), [Trial("a")])
    text = (folder_of("a", tmp_path) / OUTPUT).read_text()
    assert "Evaluation at 256 samples" in text
    assert "Evaluation at" not in capfd.readouterr().err


def test_a_defect_is_named(
    tmp_path: Path, capfd: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """An error that nobody expects, here of a trial that its process is told nothing of: no finding."""
    monkeypatch.setattr("understudy_sweeps.processes.job", lambda *_: "{}")
    (last,) = executors.carry_out(built("processes", retries=1)(work(tmp_path)), [Trial("a")])
    assert last.status.startswith("failed 2 times: its process ended with status 1 (")
    assert "Error: " in last.status
    assert "It goes on from its last checkpoint (try 2 of 2)" in capfd.readouterr().err


@pytest.mark.parametrize(
    ("device", "workers"), [("cuda", 1), ("cpu", len(os.sched_getaffinity(0)))]
)
def test_workers_by_default(
    device: str, workers: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """One on a GPU, which one training fills."""
    monkeypatch.setattr("torch.cuda.is_available", lambda: True)
    assert make("processes", Work((), str(tmp_path), device)).free() == workers


@pytest.mark.parametrize("name", ["in_process", "processes"])
def test_a_gpu_that_is_not_here_is_no_finding(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """It is refused before a trial is asked for, or a search would go on with its failure."""
    monkeypatch.setattr("torch.cuda.is_available", lambda: False)
    with pytest.raises(ConfigError, match="device=cuda:1, but torch sees no CUDA GPU here"):
        make(name, Work((), str(tmp_path), "cuda:1"))


#: The trial's seed is the GPU that its own process sees.
SEEN = "seed='${oc.decode:${oc.env:CUDA_VISIBLE_DEVICES}}'"


def gpus_of(executor: Any) -> set[str]:
    """Those in use, by one trial each."""
    hosts = [running.host for running in executor._running.values()]
    found = {host._gpu for host in hosts}
    assert len(found) == len(hosts)
    return found


def test_each_worker_has_a_gpu_of_its_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Those numbered 0 and 2 of the four that are left to the sweep; a third trial waits for one."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,5,6,7")
    given = work(tmp_path, "budget.samples=1024")
    executor = built("processes", gpus="[0,2]")(given)
    assert executor.free() == 2
    together: list[set[str]] = []

    def note(executor: Any, report: Report | None) -> None:
        together.append(gpus_of(executor))

    trials = [Trial(key, (SEEN,)) for key in "abc"]
    last = [r for r in executors.carry_out(executor, trials, meanwhile=note) if r.final]
    assert [r.status for r in last] == ["ok"] * 3
    assert {"4", "6"} in together
    seeds = [open_run(folder_of(k, tmp_path)).config["seed"] for k in "abc"]
    assert {seeds[0], seeds[1]} == {4, 6} == set(seeds)


def test_workers_share_gpus_evenly(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Whichever trials end first."""
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,5")
    executor: Any = built("processes", gpus=2, workers=4)(work(tmp_path, "budget.samples=1024"))
    assert executor.free() == 4
    most: Counter[str] = Counter()

    def note(executor: Any, report: Report | None) -> None:
        now = Counter(running.host._gpu for running in executor._running.values())
        most.update({gpu: now[gpu] - most[gpu] for gpu in now if now[gpu] > most[gpu]})

    trials = [Trial(key, (SEEN,)) for key in "abcdef"]
    last = [r for r in executors.carry_out(executor, trials, meanwhile=note) if r.final]
    assert [r.status for r in last] == ["ok"] * 6
    assert most == {"4": 2, "5": 2}


def test_a_killed_worker_leaves_its_gpu_to_the_next_try(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With as many workers as GPUs there is no other for it."""
    monkeypatch.delenv("CUDA_VISIBLE_DEVICES", raising=False)
    killed: list[int] = []

    def kill_once(executor: Any, report: Report | None) -> None:
        assert gpus_of(executor) <= {"0", "1"}
        if report is not None and not killed:
            killed.append(executor._running[report.key].host.process)
            os.kill(killed[0], signal.SIGKILL)

    executor = built("processes", gpus=2)(work(tmp_path, "budget.samples=4096"))
    trials = [Trial(key, (SEEN,)) for key in "ab"]
    last = [r for r in executors.carry_out(executor, trials, meanwhile=kill_once) if r.final]
    assert [r.status for r in last] == ["ok"] * 2
    text = "".join((folder_of(k, tmp_path) / OUTPUT).read_text() for k in "ab")
    assert killed
    assert text.count("CUDA_VISIBLE_DEVICES=") == 3, "one was tried again"


@pytest.mark.parametrize(
    ("options", "error"),
    [
        (["gpus=0"], "executor.gpus=0 is not possible: give how many"),
        (["gpus=[]"], r"executor.gpus=\[\] is not possible: give how many"),
        (["gpus=[1,1]"], "give numbers from 0 on, each once"),
        (["gpus=[-1]"], "give numbers from 0 on, each once"),
    ],
)
def test_gpus_that_make_no_sense(options: list[str], error: str) -> None:
    with pytest.raises(ConfigError, match=error):
        load_experiment(["executor=processes", *(f"executor.{o}" for o in options)])


def test_gpus_that_are_not_there(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("CUDA_VISIBLE_DEVICES", "4,5")
    with pytest.raises(ConfigError, match="of number 2, but there are 2 here"):
        built("processes", gpus=3)(work(tmp_path))
    with pytest.raises(ConfigError, match=r"device=cuda:1, but executor.gpus gives each trial"):
        built("processes", gpus=1)(Work(SMALL_STOP, str(tmp_path), "cuda:1"))


@pytest.mark.parametrize(
    "option", ["workers=0", "seconds=0", "retries=-1", "grace=-1", "threads=0"]
)
def test_options_out_of_range(option: str) -> None:
    with pytest.raises(ConfigError, match=rf"executor\.{option.partition('=')[0]}=.* not possible"):
        load_experiment(["executor=processes", f"executor.{option}"])


@pytest.mark.gpu
@pytest.mark.parametrize("gpus", ["null", "all"])
def test_on_a_gpu(gpus: str, tmp_path: Path) -> None:
    """In processes of their own; the sweep's own process never touches the device. With several
    GPUs, trials are on different ones at once."""
    before = torch.cuda.is_initialized()  # by another test of this process
    given = Work((*SMALL_STOP, "device=cuda"), str(tmp_path), "cuda")
    wanted = torch.cuda.device_count() if gpus == "all" else gpus
    executor = make("processes", given, gpus=wanted)
    assert executor.free() == (wanted if gpus == "all" else 1)
    reports = executors.carry_out(executor, executors.TRIALS)
    last = {r.key: r.status for r in reports if r.final}
    assert last == {"a": "ok", "b": "ok", "c": "ok"}
    assert torch.cuda.is_initialized() == before


def test_children_end_with_their_sweep(tmp_path: Path) -> None:
    """Killed, it cannot tell them; they save, and the folder is free again."""
    sweep = begin(
        "sweep", *SMALL_STOP, *ENDLESS, "outer_loop=grid", "executor=processes",
        "executor.workers=1", "checkpoint.minutes=1000", f"run.dir={tmp_path}",
    )  # fmt: skip
    deadline = time.monotonic() + 60
    try:
        while len(iterations(tmp_path, "base/seed0")) < 3:
            assert time.monotonic() < deadline
            time.sleep(0.05)
    finally:
        kill(sweep)
    folder = Run(folder_of("base/seed0", tmp_path), {})
    for _ in range(200):
        try:
            folder.lock()
            break
        except Exception:
            time.sleep(0.05)
    folder.lock()
    folder.unlock()
    saved = sorted(p.stem for p in folder.checkpoints.glob("*.json"))
    assert int(saved[-1]) == iterations(tmp_path, "base/seed0")[-1] >= 3


def test_a_trial_has_a_session_of_its_own(tmp_path: Path) -> None:
    """What a terminal sends to all who run in it does not reach it."""
    sessions: list[tuple[int, int]] = []

    def note(executor: Any, report: Report | None) -> None:
        for running in executor._running.values():
            if report is not None and not report.final:
                sessions.append((os.getsid(running.host.process), running.host.process))

    executors.carry_out(built("processes")(work(tmp_path)), [Trial("a")], meanwhile=note)
    assert sessions
    assert all(session == process for session, process in sessions)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGHUP])
def test_what_a_terminal_sent_while_a_trial_begins_does_not_end_it(
    number: signal.Signals, tmp_path: Path
) -> None:
    """Between the fork, where it is blocked, and the session of its own; what comes later is heard."""
    code = (
        "import os, signal; from understudy_sweeps.processes import _leave_the_terminal\n"
        "signal.signal(signal.SIGHUP, signal.SIG_DFL)\n"  # tests may run under nohup, or in the background
        "signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT, signal.SIGHUP})\n"
        f"os.kill(os.getpid(), {number.value}); _leave_the_terminal(); print('begins', flush=True)\n"
        f"os.kill(os.getpid(), {number.value}); signal.pause()"
    )
    ended = forked(code, cwd=tmp_path)
    assert ended.stdout == "begins\n", ended.stderr
    assert ended.returncode != 0


def test_what_a_terminal_sends_does_not_reach_the_fork_server(tmp_path: Path) -> None:
    """While it imports, too, when it has no handlers yet. In an interpreter of its own, whose resource tracker is not yet
    there: starting that lets SIGINT through again."""
    code = (
        "from multiprocessing import forkserver; from understudy_sweeps.processes import _server\n"
        "_server(); print(open(f'/proc/{forkserver._forkserver._forkserver_pid}/status').read())"
    )
    done = subprocess.run(
        [sys.executable, "-c", code], env=child_environment(), capture_output=True, text=True, timeout=100
    )  # fmt: skip
    blocked = int(done.stdout.partition("SigBlk:")[2].split()[0], 16)
    for number in (signal.SIGINT, signal.SIGHUP):
        assert blocked & 1 << (number - 1), done.stdout + done.stderr


class Slow(Host):
    """A process that has begun, and then says nothing."""

    def __init__(self) -> None:
        self.said = ['{"began": true}']
        self.told: list[str] = []

    def receive(self) -> str | None:
        return self.said.pop() if self.said else None

    def answer(self, stop: bool) -> None:
        self.told.append("answer")

    def save(self) -> None:
        self.told.append("save")

    def kill(self) -> None:
        self.told.append("kill")


def test_a_late_trial_has_its_grace(monkeypatch: pytest.MonkeyPatch) -> None:
    now = [100.0]
    monkeypatch.setattr(pool.time, "monotonic", lambda: now[0])
    host = Slow()
    executor = pool.Pool(
        lambda trial: host, lambda hosts, seconds: hosts, 1, pool.Limits(0, 10.0, 5.0)
    )
    executor.start(Trial("a"))
    assert executor.wait() is None
    for now[0], told in ((109.9, []), (110.1, ["save"]), (114.9, ["save"])):
        assert executor.wait() is None
        assert host.told == told
    now[0] = 115.1
    report = executor.wait()
    assert report is not None
    assert (report.status, host.told) == ("failed: it took longer than 10 s", ["save", "kill"])


def test_a_trial_waits_for_who_holds_its_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    holder = Run(tmp_path, {})
    holder.lock()
    monkeypatch.setattr(trial, "PATIENCE", 0.3)
    with pytest.raises(RunError, match="Another process is training in"):
        trial._await(tmp_path)
    monkeypatch.setattr(trial, "PATIENCE", 30.0)
    began = time.monotonic()
    threading.Timer(0.5, holder.unlock).start()
    trial._await(tmp_path)
    assert time.monotonic() - began >= 0.4
    holder.lock()  # it holds nothing itself
