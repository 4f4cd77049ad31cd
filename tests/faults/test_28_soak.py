"""Fault 28: nothing grows and nothing slows down; three minutes of it here, an hour by ``make soak``."""

from __future__ import annotations

import pytest
from soak import LIMIT, soak


@pytest.mark.slow
def test_three_minutes() -> None:
    found = soak(3.0, ())
    for name in ("memory_mb", "threads", "descriptors"):
        assert found[name]["rise"] < LIMIT, found
    assert found["samples_per_cpu_second"]["rise"] > -LIMIT, found


def test_it_is_watched() -> None:
    """Some seconds of it, so that the long one cannot rot."""
    found = soak(0.1, ("num_worlds=16",))
    assert found["descriptors"]["rise"] == pytest.approx(0.0, abs=0.3)
    assert found["samples_per_cpu_second"]["mean"] > 0
