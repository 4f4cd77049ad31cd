"""Trials in processes of this machine, so that crashes and memory of one do not affect the others.

The processes are forks of a server that has imported torch once, so they start at once.
"""

from __future__ import annotations

import contextlib
import json
import multiprocessing
import os
import signal
import sys
import threading
import time
from collections.abc import Sequence
from dataclasses import dataclass
from multiprocessing import forkserver, resource_tracker
from multiprocessing.connection import Connection, wait
from pathlib import Path
from queue import SimpleQueue
from typing import Any

from understudy.errors import ConfigError, PreemptedError
from understudy.options import check_range
from understudy.records.runs import cores
from understudy.signals import StopRequest
from understudy_sweeps.loops import Executor, Trial, Work
from understudy_sweeps.pool import Host, Limits, Lost, Pool, begun, job, message_of
from understudy_sweeps.trial import check_device, folder_of, run_trial

#: In a trial's folder: what it wrote on standard output and error.
OUTPUT = "output.txt"
#: What CUDA takes for the GPUs that there are.
_VISIBLE = "CUDA_VISIBLE_DEVICES"
#: Seconds in which a trial whose sweep is gone saves and ends.
_ORPHANED = 30.0
#: What the server imports: all that takes long.
_PRELOADED = ["understudy_sweeps.processes"]
#: What a terminal sends to all processes of a command.
_OF_TERMINALS = {signal.SIGINT, signal.SIGHUP}


class Processes:
    """Runs each trial in a child process, `workers` at once."""

    @dataclass(frozen=True)
    class Options:
        #: Trials at once; null is one for each of `gpus`, else one for each core on a CPU, and one on
        #: a GPU. More than there are GPUs share them evenly, which is worth it under CUDA's MPS.
        workers: int | None = None
        #: GPUs of this host, each worker with one of them: how many, or their numbers among those
        #: that the sweep may use (those of ``CUDA_VISIBLE_DEVICES``, where it is set). Null: all
        #: workers use what `device` says.
        gpus: int | tuple[int, ...] | None = None
        threads: int | None = None  #: of torch, in each trial; null shares the cores among workers
        retries: int = 2  #: times that a trial goes on from its checkpoint after its process died
        seconds: float | None = None  #: s, that one try takes at most; null has no limit
        grace: float = 30.0  #: seconds to save, for a trial that is told to end

        def __post_init__(self) -> None:
            check_range(self, "workers", "threads", least=1, most=1024)
            check_range(self, "retries", "grace", least=0)
            check_range(self, "seconds", above=0)
            check_range(self, "gpus", most=1024)
            _check_gpus(self.gpus)

    def __new__(cls, options: Options, work: Work) -> Executor:
        if options.gpus is None:  # else those that there are, are counted
            check_device(work)
        gpus = None if options.gpus is None else _Gpus(options.gpus, work.device)
        server = _server()
        if gpus is not None:
            default = gpus.count
        elif work.device.startswith("cuda"):
            default = 1
        else:
            default = max(1, cores() // (options.threads or 1))
        workers = options.workers or default
        threads = options.threads or max(1, cores() // workers)

        def start(trial: Trial) -> Host:
            return _Child(server, trial, work, threads, gpus)

        limits = Limits(options.retries, options.seconds, options.grace)
        return Pool(start, _await, workers, limits)


def _check_gpus(gpus: int | tuple[int, ...] | None) -> None:
    """A ValueError that begins with the option's name, if there can be no such GPUs."""
    if gpus is None:
        return
    numbers = tuple(range(gpus)) if isinstance(gpus, int) else gpus
    given = f"gpus={gpus if isinstance(gpus, int) else list(gpus)} is not possible: "
    if not numbers:
        raise ValueError(f"{given}give how many to use, or the numbers of one or more.")
    if min(numbers) < 0 or len(set(numbers)) < len(numbers):
        raise ValueError(f"{given}give numbers from 0 on, each once.")


class _Gpus:
    """Which of them how many trials use now, as values of ``CUDA_VISIBLE_DEVICES``."""

    def __init__(self, wanted: int | tuple[int, ...], device: str) -> None:
        numbers = tuple(range(wanted)) if isinstance(wanted, int) else wanted
        visible = os.environ.get(_VISIBLE)
        names = None if visible is None else [v.strip() for v in visible.split(",") if v.strip()]
        there = None if names is None else len(names)
        if device.startswith("cuda"):
            if device != "cuda":
                raise ConfigError(
                    f"device={device}, but executor.gpus gives each trial its GPU. Use device=cuda."
                )
            import torch

            there = torch.cuda.device_count()  # asks the driver's library: no context is made here
        if there is not None and max(numbers) >= there:
            raise ConfigError(
                f"executor.gpus asks for the GPU of number {max(numbers)}, but there are {there} "
                f"here{'' if visible is None else f' ({_VISIBLE}={visible})'}. Give {there} at most, "
                "or numbers below that."
            )
        self._trials = {str(n) if names is None else names[n]: 0 for n in numbers}
        self.count = len(numbers)

    def take(self) -> str:
        """The one that the fewest trials use."""
        gpu = min(self._trials, key=lambda name: self._trials[name])
        self._trials[gpu] += 1
        return gpu

    def give(self, gpu: str) -> None:
        self._trials[gpu] -= 1


def _server() -> Any:
    """What forks the trials; what a terminal sends to all (Ctrl-C, its end) is the sweep's alone."""
    server = multiprocessing.get_context("forkserver")
    server.set_forkserver_preload(_PRELOADED)
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _OF_TERMINALS)
    try:
        resource_tracker.ensure_running()  # first, since it lets SIGINT through again
        signal.pthread_sigmask(signal.SIG_BLOCK, _OF_TERMINALS)
        forkserver.ensure_running()
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)
    return server


class _Child(Host):
    """A child process, and this end of the pipe to it."""

    def __init__(
        self, server: Any, trial: Trial, work: Work, threads: int, gpus: _Gpus | None
    ) -> None:
        self.pipe, theirs = server.Pipe()
        self._gpus, self._gpu = gpus, gpus and gpus.take()
        output = folder_of(trial.key, work.folder) / OUTPUT
        arguments = (theirs, job(trial, work, threads), str(output.absolute()), self._gpu)
        self._process = server.Process(target=_carry_out, args=arguments, daemon=True)
        self._process.start()
        self.process = self._process.pid
        theirs.close()

    def receive(self) -> str | None:
        try:
            return self.pipe.recv_bytes().decode() if self.pipe.poll() else None
        except (EOFError, OSError):
            self._process.join(_ORPHANED)
            code = self._process.exitcode
        if code is not None and code < 0:
            raise Lost(f"its process was killed ({signal.Signals(-code).name})")
        raise Lost(f"its process ended with status {code}")

    def answer(self, stop: bool) -> None:
        self._send({"stop": stop})

    def save(self) -> None:
        self._send({"save": True})

    def _send(self, message: Any) -> None:
        with contextlib.suppress(OSError):  # it is gone, as the next message will say
            self.pipe.send_bytes(json.dumps(message).encode())

    def kill(self) -> None:
        self._process.kill()
        self._process.join()
        self.pipe.close()
        if self._gpus is not None and self._gpu is not None:  # its memory is free by now
            self._gpus.give(self._gpu)


def _await(hosts: Sequence[Host], seconds: float) -> Sequence[Host]:
    pipes = {host.pipe: host for host in hosts if isinstance(host, _Child)}
    return [pipes[pipe] for pipe in wait(list(pipes), seconds)]


# ---------------------------------------------------------------------- in the child


def _leave_the_terminal() -> None:
    """Have a session of its own, to which also no signal comes that was sent before."""
    os.setsid()  # Ctrl-C is the sweep's, which then lets this save
    for number in _OF_TERMINALS:  # which the server blocks
        before = signal.signal(number, signal.SIG_IGN)  # one that waits is dropped
        signal.signal(number, before)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _OF_TERMINALS)


def _carry_out(pipe: Connection, text: str, output: str, gpu: str | None) -> None:
    _leave_the_terminal()
    if gpu is not None:  # before anything asks for a GPU, which is when CUDA reads it
        os.environ[_VISIBLE] = gpu
    Path(output).parent.mkdir(parents=True, exist_ok=True)
    file = os.open(output, os.O_WRONLY | os.O_CREAT | os.O_APPEND, 0o644)
    for stream in (1, 2):
        os.dup2(file, stream)
    if gpu is not None:
        print(f"{_VISIBLE}={os.environ[_VISIBLE]}", flush=True)
    answers: SimpleQueue[bool | None] = SimpleQueue()
    threading.Thread(target=_hear, args=(pipe, answers), daemon=True).start()
    pipe.send_bytes(b'{"began": true}')
    try:
        trial, work = begun(text)
        with StopRequest(at_once=True), contextlib.closing(run_trial(trial, work)) as reports:
            report = next(reports)
            while True:
                stop: bool | None = False
                if report is not None:
                    pipe.send_bytes(message_of(report).encode())
                    if report.final:
                        return
                    stop = answers.get()
                    if stop is None:
                        sys.exit(PreemptedError.exit_status)
                report = reports.send(stop)
    except (PreemptedError, KeyboardInterrupt):  # the trial goes on from its checkpoint
        sys.exit(PreemptedError.exit_status)
    except Exception as error:
        pipe.send_bytes(json.dumps({"error": f"{type(error).__name__}: {error}"}).encode())
        raise


def _hear(pipe: Connection, answers: SimpleQueue[bool | None]) -> None:
    """Pass on answers; told to save, or left alone, let the trial end at its next boundary."""

    def end() -> None:
        os.kill(os.getpid(), signal.SIGTERM)
        answers.put(None)

    try:
        while True:
            message = json.loads(pipe.recv_bytes())
            if "stop" in message:
                answers.put(message["stop"])
            else:
                end()
    except (EOFError, OSError):
        end()
        time.sleep(_ORPHANED)
        os._exit(PreemptedError.exit_status)
