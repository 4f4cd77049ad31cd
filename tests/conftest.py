"""Fixtures for all tests."""

from __future__ import annotations

import gc
import itertools
import re
import subprocess
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import understudy_mujoco  # noqa: F401 # isort: skip - it chooses what draws before mujoco is imported
import coarse_films
import known_entries
import lazy_choices
import mujoco
import pytest
import readers
import torch
from miniatures import make_stages
from worlds import all_plugins

from understudy.setup.plugins import Plugins
from understudy_characters.character import Character
from understudy_humanoid.character import build_spec
from understudy_mujoco import apart

torch.set_num_threads(1)  # the networks are tiny, and tests share their machine

pytest.MonkeyPatch().setattr(
    apart, "subprocess", SimpleNamespace(run=readers.run, TimeoutExpired=subprocess.TimeoutExpired)
)

mujoco.Renderer.__init__ = coarse_films.coarse
lazy_choices.use()
known_entries.use()

gc.disable()  # of the million objects that imports make hardly one goes


def pytest_collection_finish() -> None:
    """What is there stays to the end: not to be gone through again and again."""
    gc.freeze()
    gc.set_threshold(100_000, 50, 20)
    gc.enable()


_counted = itertools.count()


@pytest.fixture
def tmp_path(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """As pytest's, which goes through the folders of all tests before for the next free number."""
    name = re.sub(r"\W", "_", request.node.name)[:30]
    path = tmp_path_factory.getbasetemp() / f"{name}{next(_counted)}"
    path.mkdir(mode=0o700)
    return path


@pytest.fixture(scope="session")
def plugins() -> Plugins:
    """The installed plugins and the tests' own small tasks."""
    return all_plugins()


@pytest.fixture(scope="session")
def humanoid() -> Character:
    return Character("humanoid", build_spec().compile())


@pytest.fixture(scope="session")
def built_on(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs that some of the miniatures build on."""
    return make_stages(tmp_path_factory.mktemp("stages"))


@pytest.fixture
def fresh_readers(monkeypatch: pytest.MonkeyPatch) -> None:
    """What reads strangers' files is a fresh interpreter, no fork."""
    monkeypatch.setattr(apart, "subprocess", subprocess)


@pytest.fixture
def fine_films(monkeypatch: pytest.MonkeyPatch) -> None:
    """Pictures are as the product draws them."""
    monkeypatch.setattr(mujoco.Renderer, "__init__", coarse_films.fine)


@pytest.fixture
def two_threads() -> Iterator[None]:
    """torch has two."""
    before = torch.get_num_threads()
    torch.set_num_threads(2)
    yield
    torch.set_num_threads(before)
