"""Fixtures for all tests."""

from __future__ import annotations

import pytest
import torch
from worlds import all_plugins

from understudy.plugins import Plugins

torch.set_num_threads(1)  # the networks are tiny, and tests share their machine


@pytest.fixture(scope="session")
def plugins() -> Plugins:
    """The installed plugins and the tests' own small tasks."""
    return all_plugins()
