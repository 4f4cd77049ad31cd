"""Runs one trial after another in this process."""

from __future__ import annotations

from collections.abc import Generator

from understudy_sweeps.loops import Executor, Report, Trial, Work
from understudy_sweeps.trial import check_device, run_trial


class InProcess(Executor):
    """No parallelism and no isolation: a trial that crashes the process stops the sweep."""

    def __init__(self, options: None, work: Work) -> None:
        check_device(work)
        self._work = work
        self._reports: Generator[Report | None, bool | None, None] | None = None
        self._answer: bool | None = None  #: None before the first report

    def free(self) -> int:
        return int(self._reports is None)

    def start(self, trial: Trial) -> None:
        self._reports, self._answer = run_trial(trial, self._work), None

    def wait(self) -> Report | None:
        assert self._reports is not None
        report = self._reports.send(self._answer)
        self._answer = False
        if report is not None and report.final:
            self.close()
        return report

    def stop(self, key: str) -> None:
        self._answer = True

    def close(self) -> None:
        if self._reports is not None:
            self._reports.close()
        self._reports = None
