"""What is compiled for the first step of a process is told apart from training."""

from __future__ import annotations

import time

import pytest
from counted_task import LINE_TASK, line_plugins
from worlds import make_training

from understudy_reinforcement.job import Reinforcement

SLOW = 0.2
"""s that the first step takes longer."""


def test_the_first_step_of_a_process_is_not_counted_as_training(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    training = make_training(line_plugins(), LINE_TASK)
    job = training.job
    assert isinstance(job, Reinforcement)
    step, waits = job.environment.step, [SLOW]

    def compiled_first(action):
        time.sleep(waits.pop() if waits else 0.0)
        return step(action)

    monkeypatch.setattr(job.environment, "step", compiled_first)
    began = time.perf_counter()
    first = training.iterate()
    whole = time.perf_counter() - began
    assert 0.0 < first["seconds"] <= whole - SLOW + 1e-3
    assert "compiling" not in first
    assert job.collector.compiling >= SLOW
    training.iterate()
    assert job.collector.compiling == 0.0, "later ones count in full"
