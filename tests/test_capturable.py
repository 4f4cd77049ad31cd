"""On a GPU the steps of every bundled task can be captured as a CUDA graph: nothing in them waits."""

from __future__ import annotations

import parts_and_tasks
import pytest

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.testing import check_capturable

PLUGINS = parts_and_tasks.bundled()


@pytest.mark.parametrize("task", sorted(t.name for t in PLUGINS.registry.tasks.values()))
def test_steps_can_be_captured(task: str) -> None:
    built = build_environment(load_experiment([f"task={task}", "num_worlds=4"], PLUGINS))
    try:
        check_capturable(built.environment)
    finally:
        built.environment.close()
