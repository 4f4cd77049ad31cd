"""What runs on the cluster: one trial, advanced when it is asked to. Speaks JSON."""

from __future__ import annotations

import json
import os
import time
from collections.abc import Generator

import ray

from understudy_sweeps.loops import Report
from understudy_sweeps.pool import begun, message_of
from understudy_sweeps.trial import run_trial


class Carrier:
    """Carries out the trial of a :func:`understudy_sweeps.pool.job`."""

    def __init__(self, job: str) -> None:
        self._job = job
        self._reports: Generator[Report | None, bool | None, None] | None = None

    def where(self) -> str:
        """On which node of the cluster, and in which process there, as JSON."""
        return json.dumps([ray.get_runtime_context().get_node_id(), os.getpid()])

    def go_on(self, stop: bool, seconds: float) -> str:
        """Until the next report, `seconds` at most: the message, empty if there is no report.
        `stop` answers the last one."""
        deadline = time.monotonic() + seconds
        answer: bool | None = stop
        if self._reports is None:
            self._reports, answer = run_trial(*begun(self._job)), None
        while True:
            report = self._reports.send(answer)
            if report is not None:
                return message_of(report)
            answer = False
            if time.monotonic() > deadline:
                return ""

    def close(self) -> None:
        """Leave the trial saved."""
        if self._reports is not None:
            self._reports.close()
