"""Files of options are read once, unless they change."""

from __future__ import annotations

from pathlib import Path

import pytest
from hydra._internal.config_search_path_impl import ConfigSearchPathImpl
from hydra.core.plugins import Plugins as HydrasPlugins

from understudy.setup.composition import compose_raw
from understudy.setup.kept import KeptOptions
from understudy.setup.plugins import Plugins


@pytest.fixture
def repository(tmp_path: Path) -> KeptOptions:
    """Of the folders ``first`` and ``second``."""
    HydrasPlugins.instance()  # which finds what reads files
    path = ConfigSearchPathImpl()
    for name in ("first", "second"):
        (tmp_path / name).mkdir()
        path.append("test", f"file://{tmp_path / name}")
    return KeptOptions(path)


def x_of(repository: KeptOptions) -> object:
    found = repository.load_config("a")
    return found and found.config.x  # type: ignore[union-attr]


def test_what_changes_is_read_anew(repository: KeptOptions, tmp_path: Path) -> None:
    assert x_of(repository) is None
    (tmp_path / "second" / "a.yaml").write_text("x: 1\n")
    assert x_of(repository) == 1
    (tmp_path / "second" / "a.yaml").write_text("x: 22\n")
    assert x_of(repository) == 22
    (tmp_path / "first" / "a.yaml").write_text("x: 3\n")
    assert x_of(repository) == 3
    (tmp_path / "first" / "a.yaml").unlink()
    assert x_of(repository) == 22


def test_what_is_kept_is_not_what_is_handed_out(repository: KeptOptions, tmp_path: Path) -> None:
    (tmp_path / "first" / "a.yaml").write_text("x: 1\n")
    found = repository.load_config("a")
    assert found is not None
    found.config.x = 2  # type: ignore[union-attr]
    assert x_of(repository) == 1


def test_one_composition_leaves_nothing_to_the_next(plugins: Plugins) -> None:
    plain = ["experiment=spacetime/walk"]
    before = compose_raw(plain, plugins)
    for more in ("learner.gamma=0.5", "policy=mlp", "episode.seconds=3", "+learner.clip=0.1"):
        assert compose_raw([*plain, more], plugins) != before
    assert compose_raw(plain, plugins) == before
