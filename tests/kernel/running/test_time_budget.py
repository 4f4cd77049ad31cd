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


@pytest.mark.parametrize(("compiling", "iterations"), [(0.0, 1), (90.0, 4), (115.0, 24)])
def test_what_is_compiled_is_none_of_the_minutes(
    compiling: float, iterations: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    """As on a new machine with a GPU, where the first iteration compiles for a minute: of two, nothing was left but that
    iteration, since the next was taken to last as long."""
    overrides = [*LINE_TASK, "budget.minutes=2", "budget.samples=null"]
    training = make_training(line_plugins(), overrides)
    ticks = count()
    first = 120.0  # s; later ones take what the first does without compiling
    moments = [0.0, first, *(first + (first - compiling) * ((k - 1) // 2) for k in range(2, 60))]
    clock = SimpleNamespace(perf_counter=lambda: moments[next(ticks)])
    monkeypatch.setattr(loop, "time", clock)
    iterate, left = training.job.iterate, [compiling]
    monkeypatch.setattr(
        training.job,
        "iterate",
        lambda samples: iterate(samples) | {"compiling": left.pop() if left else 0.0},
    )
    rows = list(training.rows())
    assert training.outcome == "budget"
    assert rows[0]["seconds"] == first - compiling
    assert "compiling" not in rows[0]
    assert training.progress.seconds <= 120.0
    assert len(rows) == iterations
