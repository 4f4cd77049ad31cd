"""Trials side by side, each in a process of its own, which may die, hang, or take too long.

The processes may be children of this one or actors of a cluster. They exchange JSON: they receive a :func:`job` and
answers to reports, and send messages ``{"began": …}``, ``{"report": …}`` and ``{"error": …}``.
"""

from __future__ import annotations

import dataclasses
import json
import os
import time
from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

from understudy.command.command import tell
from understudy_sweeps.journal import trial_of
from understudy_sweeps.loops import Executor, Report, Trial, Work

__all__ = ["PAUSE", "Host", "Limits", "Lost", "Pool", "begun", "job", "message_of"]

#: Seconds without a message after which whoever waits may look around.
PAUSE = 0.5


class Lost(Exception):
    """The process ended without a result, for this reason."""


class Host(ABC):
    """A process that carries out one trial."""

    process: int | None = None  #: its number on its machine, once that is known

    @abstractmethod
    def receive(self) -> str | None:
        """The next message, or None if there is none yet; Lost if there never will be one."""

    @abstractmethod
    def answer(self, stop: bool) -> None:
        """Answer a report: continue, or end with what was learned so far."""

    @abstractmethod
    def save(self) -> None:
        """Tell it to save and to end; returns at once."""

    @abstractmethod
    def kill(self) -> None:
        """End it now; returns when it has ended."""


#: Waits until one of several hosts has something to say, some seconds at most; those that have.
Await = Callable[[Sequence[Host], float], Sequence[Host]]


@dataclass(frozen=True)
class Limits:
    """The limits of a trial."""

    retries: int  #: times that a trial goes on from its checkpoint after its process was lost
    seconds: float | None  #: s, that one try takes at most; None has no limit
    grace: float  #: seconds to save, for a trial that is told to end


@dataclass
class _Running:
    trial: Trial
    host: Host
    tries: int = 1
    deadline: float | None = None  #: since it began
    late: bool = False
    paused: bool = False  #: it reported and waits for an answer
    error: str = ""  #: what it said before it ended
    cost: float = 0.0


class Pool(Executor):
    """At most `workers` hosts at once, each made by `start` from a trial; `leave` is called last."""

    def __init__(
        self,
        start: Callable[[Trial], Host],
        wait: Await,
        workers: int,
        limits: Limits,
        leave: Callable[[], None] = lambda: None,
    ) -> None:
        self._start, self._wait, self._workers, self._limits = start, wait, workers, limits
        self._leave = leave
        self._running: dict[str, _Running] = {}

    def free(self) -> int:
        return self._workers - len(self._running)

    def start(self, trial: Trial) -> None:
        self._running[trial.key] = _Running(trial, self._start(trial))

    def wait(self) -> Report | None:
        for running in self._running.values():
            if running.paused:
                running.host.answer(stop=False)
                running.paused = False
        report = self._end_the_late()
        if report is not None:
            return report
        by_host = {id(r.host): r for r in self._running.values()}
        for host in self._wait([r.host for r in self._running.values()], PAUSE):
            report = self._listen(by_host[id(host)])
            if report is not None:
                return report
        return None

    def stop(self, key: str) -> None:
        running = self._running[key]
        running.host.answer(stop=True)
        running.paused = False

    def close(self) -> None:
        """Tell all to save at the same time, within one period of grace."""
        left = [running.host for running in self._running.values()]
        for running in self._running.values():
            running.host.save()
        deadline = time.monotonic() + self._limits.grace
        try:
            while left and time.monotonic() < deadline:
                for host in self._wait(left, PAUSE):
                    try:
                        host.receive()
                    except Lost:
                        left.remove(host)
        finally:
            for running in self._running.values():
                running.host.kill()
            self._running.clear()
            self._leave()

    def _listen(self, running: _Running) -> Report | None:
        """The host's message, if it concerns the sweep."""
        try:
            text = running.host.receive()
        except Lost as why:
            return self._lost(running, str(why))
        message = json.loads(text) if text else {}
        if "began" in message and self._limits.seconds is not None:
            running.deadline = time.monotonic() + self._limits.seconds
        running.error = message.get("error", running.error)
        if "report" not in message:
            return None
        report = Report(**message["report"])
        running.cost = report.cost
        running.paused = not report.final
        if report.final:
            del self._running[report.key]
            running.host.kill()  # it has nothing left to do
        return report

    def _end_the_late(self) -> Report | None:
        """Tell those that take too long to save, and kill those that do not."""
        for running in list(self._running.values()):
            if running.deadline is None or time.monotonic() < running.deadline:
                continue
            if running.late:
                report = self._lost(running, "")
                if report is not None:
                    return report
            else:
                running.late = True
                running.deadline += self._limits.grace
                running.host.save()
        return None

    def _lost(self, running: _Running, why: str) -> Report | None:
        """Try again, or report that no try is left."""
        running.host.kill()
        if running.late:
            why = f"it took longer than {self._limits.seconds:g} s"
        elif running.error:
            why = f"{why} ({running.error})"
        key, limit = running.trial.key, self._limits.retries + 1
        if running.tries < limit:
            tell(
                f"{key}: {why}. It goes on from its last checkpoint (try {running.tries + 1} of {limit})."
            )
            host = self._start(running.trial)
            self._running[key] = _Running(running.trial, host, running.tries + 1, cost=running.cost)
            return None
        del self._running[key]
        tries = f" {limit} times" if limit > 1 else ""
        return Report(key, f"failed{tries}: {why}", cost=running.cost)


# ---------------------------------------------------------------------- what a host is sent


def job(trial: Trial, work: Work, threads: int) -> str:
    """All that another process needs to carry out `trial`."""
    found = {"trial": dataclasses.asdict(trial), "work": dataclasses.asdict(work)}
    return json.dumps({**found, "threads": threads, "folder": os.getcwd()})


def begun(text: str) -> tuple[Trial, Work]:
    """In the other process: the job, with this process made ready for it."""
    import torch

    given: dict[str, Any] = json.loads(text)
    os.chdir(given["folder"])
    torch.set_num_threads(given["threads"])
    work = given["work"]
    return trial_of(given["trial"]), Work(**{**work, "overrides": tuple(work["overrides"])})


def message_of(report: Report) -> str:
    """The line in which a worker says `report`."""
    return json.dumps({"report": dataclasses.asdict(report)})
