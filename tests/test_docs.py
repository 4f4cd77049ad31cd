"""The documents cannot rot: their commands compose, their code is the tested code, links exist."""

from __future__ import annotations

import importlib
import re
import shlex
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from understudy.setup.composition import compose_raw, load_experiment
from understudy.setup.plugins import Plugins, installed, load
from understudy.testing import check_plugin

ROOT = Path(__file__).resolve().parents[1]
PAGES = [
    ROOT / "README.md",
    *sorted((ROOT / "docs").rglob("*.md")),
    *sorted((ROOT / "plugins").glob("*/README.md")),
]
TUTORIAL = ROOT / "docs" / "plugin-tutorial.md"
EXTERNAL = ROOT / "tests" / "external" / "understudy-balance"


def commands(page: Path) -> list[list[str]]:
    """The overrides of every train and sweep command of `page`."""
    found = re.findall(r"^understudy (?:train|sweep) (.*)$", page.read_text(encoding="utf-8"), re.M)
    return [shlex.split(line, comments=True) for line in found]


COMMANDS = [
    overrides
    for page in PAGES
    if page != TUTORIAL
    for overrides in commands(page)
    if not any(o.startswith("motion.file") or "SKILL" in o or "=S" in o for o in overrides)
]


@pytest.mark.parametrize("overrides", COMMANDS, ids=" ".join)
def test_commands_compose(overrides: list[str]) -> None:
    if (compose_raw(overrides).get("simulator") or {}).get("name") == "mujoco_warp":
        pytest.importorskip("mujoco_warp._src", reason="MuJoCo Warp is not installed")
    load_experiment(overrides, installed())


def tutorial_files() -> dict[str, str]:
    """The files that the tutorial shows, by path."""
    text = TUTORIAL.read_text(encoding="utf-8")
    return dict(re.findall(r"^`(\S+)`:\n\n```\w+\n(.*?)```", text, re.M | re.S))


@pytest.fixture
def balance(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Plugins]:
    """The installed plugins and the tutorial's, from files written as the page shows them."""
    for name, text in tutorial_files().items():
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding="utf-8")
    monkeypatch.syspath_prepend(tmp_path / "src")
    yield load(extra=[("balance", importlib.import_module("understudy_balance"))])
    for name in [n for n in sys.modules if n.partition(".")[0] == "understudy_balance"]:
        del sys.modules[name]


def test_the_tutorial_shows_all_of_the_tested_distribution() -> None:
    tested = {
        file.relative_to(EXTERNAL).as_posix(): file.read_text(encoding="utf-8")
        for file in EXTERNAL.rglob("*")
        if file.suffix in (".py", ".toml", ".yaml")
    }
    assert tutorial_files() == tested


def test_what_the_tutorial_grows_works(balance: Plugins) -> None:
    overrides = commands(TUTORIAL)
    assert len(overrides) == 4
    for items in overrides:
        experiment = load_experiment(items, balance)
        assert "balance/upright" in [
            term.component.name for term in experiment.many("reward.terms")
        ]
    check_plugin("balance", balance)


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_exist(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target
