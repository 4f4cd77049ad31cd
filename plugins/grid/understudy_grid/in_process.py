"""Runs one trial after another in this process."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence

from understudy.outer.trials import Executor, Result, Trial


class InProcess(Executor):
    """No parallelism, no isolation: a trial that crashes the process stops the sweep."""

    def __init__(self, options: None = None, context: None = None) -> None:
        pass

    def run(self, trials: Sequence[Trial], train: Callable[[Trial], Result]) -> Iterator[Result]:
        for trial in trials:
            yield train(trial)
