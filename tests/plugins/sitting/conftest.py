"""Tasks of sitting, built once."""

from __future__ import annotations

import pytest
from sitting_tasks import build

from understudy.setup.building import Built


@pytest.fixture(scope="session")
def sit() -> Built:
    """Sitting down from the clip's first frame, 4 worlds."""
    built = build("experiment=sitting/sit", "num_worlds=4", "initial_states.span=[0.0,0.0]")
    built.environment.reset()
    return built
