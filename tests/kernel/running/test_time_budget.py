"""``budget.minutes``: an iteration that would end after the time is not begun."""

from __future__ import annotations

from itertools import count
from types import SimpleNamespace

import pytest
from counted_task import LINE_TASK, line_plugins
from worlds import make_training

from understudy.running import training as loop


@pytest.mark.parametrize(("seconds", "iterations"), [(25.0, 2), (31.0, 1), (59.0, 1), (100.0, 1), (20.0, 3), (7.0, 8)])  # fmt: skip
def test_no_iteration_begins_that_would_end_too_late(
    seconds: float, iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of iterations of 25 s two fit into a minute. The first is made however long it takes."""
    training = make_training(
        line_plugins(), [*LINE_TASK, "budget.minutes=1", "budget.samples=null"]
    )
    ticks = count()  # the clock is asked before and after an iteration
    clock = SimpleNamespace(perf_counter=lambda: seconds * ((next(ticks) + 1) // 2))
    monkeypatch.setattr(loop, "time", clock)
    assert training.train() == "budget"
    assert training.progress.iteration == iterations
    assert training.ended(), "nor when it is resumed"
