"""A character and clean clips."""

from __future__ import annotations

import pytest
from damage import walking

from understudy_humanoid.clips import generated_walk
from understudy_motion.clip import Clip


@pytest.fixture(scope="session")
def walk() -> Clip:
    """One gait cycle, looping."""
    return generated_walk()


@pytest.fixture(scope="session")
def walks(walk: Clip) -> Clip:
    """Three gait cycles of 1.05 s, not looping; the left foot stands from 1.56 to 2.21 s."""
    return walking(walk)
