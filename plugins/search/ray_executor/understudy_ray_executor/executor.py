"""Trials as actors of a Ray cluster; what a lost actor or a late one means is as for processes."""

from __future__ import annotations

import contextlib
import json
import logging
import os
import signal
import socket
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from understudy.errors import PluginError, UnderstudyError
from understudy.options import check_range
from understudy_sweeps.loops import Executor, Trial, Work
from understudy_sweeps.pool import PAUSE, Host, Limits, Lost, Pool, job

try:
    import ray
    from ray.exceptions import RayError, RayTaskError
except ImportError as error:
    raise PluginError("Ray is not installed (pip install 'understudy[ray]')") from error

from understudy_ray_executor.actor import Carrier

#: Bytes of shared memory on a cluster of our own: messages are short.
_OBJECT_STORE = 100 * 2**20


class RayExecutor:
    """Each trial an actor of a cluster: a :class:`Pool` of actors. All its machines need the sweep's
    folder under the same path, and this understudy."""

    @dataclass(frozen=True)
    class Options:
        address: str | None = None  #: of a cluster (``auto``, ``ray://…``); null starts one here
        #: trials at once; null is as many as there is room for. Of more some wait, until the cluster grows
        workers: int | None = None
        num_cpus: float = 1.0  #: CPU cores that Ray keeps for a trial
        num_gpus: float | None = None  #: of a trial; null is one where device=cuda, else none
        threads: int = 1  #: of torch, in each trial
        retries: int = 2  #: times that a trial goes on from its checkpoint after its actor was lost
        seconds: float | None = None  #: s, that one try takes at most; null has no limit
        grace: float = 30.0  #: seconds to save, for a trial that is told to end

        def __post_init__(self) -> None:
            check_range(self, "workers", "threads", least=1, most=10_000)
            check_range(self, "num_cpus", "seconds", above=0)
            check_range(self, "num_gpus", "retries", "grace", least=0)

    def __new__(cls, options: Options, work: Work) -> Executor:
        gpus = options.num_gpus
        if gpus is None:
            gpus = 1.0 if work.device.startswith("cuda") else 0.0
        leave = _nothing if ray.is_initialized() else ray.shutdown
        if leave is not _nothing:
            _connect(options.address)
        try:
            wanted = {"CPU": options.num_cpus, "GPU": gpus}
            workers = options.workers or _room(wanted)
        except BaseException:
            leave()
            raise
        kind = ray.remote(Carrier).options(
            num_cpus=options.num_cpus, num_gpus=gpus, max_restarts=0, max_task_retries=0
        )

        def start(trial: Trial) -> Host:
            return _Actor(kind.remote(job(trial, work, options.threads)))

        limits = Limits(options.retries, options.seconds, options.grace)
        return Pool(start, _await, workers, limits, leave)


def _nothing() -> None:
    """The cluster is somebody else's."""


def _connect(address: str | None) -> None:
    """Join the cluster at `address`, or start one on this machine."""
    own: dict[str, Any] = {}
    if address is None:
        own = {"include_dashboard": False, "object_store_memory": _OBJECT_STORE}
    try:
        _reach(address)
        ray.init(address or "local", log_to_driver=False, logging_level=logging.ERROR, **own)
    except (ConnectionError, ValueError, RuntimeError, OSError) as error:
        reason = str(error).splitlines()[0] if str(error) else type(error).__name__
        if address is None:
            raise UnderstudyError(
                f"No Ray cluster starts on this machine: {reason.rstrip('.')}. Stop others (ray stop), "
                "give executor.address of one, or choose executor=processes."
            ) from error
        raise UnderstudyError(
            f"There is no Ray cluster at executor.address={address}: {reason.rstrip('.')}. Start one "
            "(ray start --head), or leave the address out to use this machine."
        ) from error


def _reach(address: str | None) -> None:
    """An OSError at once where nobody listens: Ray would try for minutes."""
    host, _, port = (address or "").rpartition("://")[2].rpartition(":")
    if port.isdigit():
        socket.create_connection((host.strip("[]"), int(port)), timeout=10).close()


def _room(wanted: dict[str, float]) -> int:
    """How many trials the cluster has room for."""
    found = ray.cluster_resources()
    room = min(int(found.get(name, 0.0) / share) for name, share in wanted.items() if share > 0)
    if room < 1:
        needs = " and ".join(f"{v:g} {k}" for k, v in wanted.items() if v > 0)
        has = ", ".join(f"{found.get(k, 0.0):g} {k}" for k in wanted)
        raise UnderstudyError(
            f"A trial needs {needs}, and the Ray cluster has {has}. Lower executor.num_cpus or "
            "executor.num_gpus, or choose another cluster."
        )
    return room


class _Actor(Host):
    """An actor, and the call to it that is under way."""

    def __init__(self, actor: Any) -> None:
        self._actor, self._answer = actor, False
        self._saving, self._node = False, ""
        self.call: Any = actor.where.remote()

    def receive(self) -> str | None:
        if self.call is None or not ray.wait([self.call], timeout=0)[0]:
            return None
        call, self.call = self.call, None
        try:
            message: Any = ray.get(call)
        except RayTaskError as error:
            raise Lost(f"it failed with {_words(error.cause)}") from error
        except RayError as error:
            raise Lost(f"its process on the cluster died ({type(error).__name__})") from error
        if self.process is None:
            self._node, self.process = json.loads(message)
            message = '{"began": true}'
        elif message is None:
            raise Lost("it was told to end")
        if self._saving:
            self.call = self._actor.close.remote()
        elif '"report"' not in message:
            self._go_on()
        return message

    def _go_on(self) -> None:
        self.call = self._actor.go_on.remote(self._answer, PAUSE)
        self._answer = False

    def answer(self, stop: bool) -> None:
        if not self._saving:
            self._answer = stop
            self._go_on()

    def save(self) -> None:
        self._saving = True
        if self.call is None:
            self.call = self._actor.close.remote()

    def kill(self) -> None:
        ray.kill(self._actor)
        if self.process is not None and self._node == ray.get_runtime_context().get_node_id():
            with contextlib.suppress(ProcessLookupError):  # one that hangs does not listen to Ray
                os.kill(self.process, signal.SIGKILL)


def _words(error: Any) -> str:
    lines = str(error).strip().splitlines()
    return f"{type(error).__name__}: {lines[0]}" if lines else type(error).__name__


def _await(hosts: Sequence[Host], seconds: float) -> Sequence[Host]:
    calls = {
        host.call: host for host in hosts if isinstance(host, _Actor) and host.call is not None
    }
    ready, _ = ray.wait(list(calls), timeout=seconds) if calls else ([], [])
    return [calls[call] for call in ready]
