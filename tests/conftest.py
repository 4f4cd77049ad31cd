"""Fixtures for all tests."""

from __future__ import annotations

import pytest

from understudy.plugins import Plugins
from worlds import all_plugins


@pytest.fixture(scope="session")
def plugins() -> Plugins:
    """The installed plugins and the tests' own small tasks."""
    return all_plugins()
