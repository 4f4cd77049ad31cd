"""The documents cannot rot: their commands compose, their code is the tested code, links exist."""

from __future__ import annotations

import re
import shlex
from pathlib import Path

import pytest

from understudy.config import load_experiment
from understudy.plugins import installed

ROOT = Path(__file__).resolve().parents[1]
PAGES = [ROOT / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
TUTORIAL = (ROOT / "docs" / "plugin-tutorial.md").read_text(encoding="utf-8")
EXTERNAL = ROOT / "tests" / "external" / "understudy-balance"


def commands() -> list[list[str]]:
    """The overrides of every train and sweep command that needs nothing of the reader's own."""
    found = []
    for page in PAGES:
        for line in re.findall(r"^understudy (?:train|sweep) (.*)$", page.read_text(), re.M):
            overrides = shlex.split(line, comments=True)
            if not any("balance" in o or o.startswith("motion.file") for o in overrides):
                found.append(overrides)
    return found


@pytest.mark.parametrize("overrides", commands(), ids=" ".join)
def test_commands_compose(overrides: list[str]) -> None:
    if "simulator=mujoco_warp" in overrides:
        pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    load_experiment(overrides, installed())


def test_the_tutorial_shows_the_tested_code() -> None:
    blocks = re.findall(r"^`(\S+)`:\n\n```\w+\n(.*?)```", TUTORIAL, re.M | re.S)
    assert len(blocks) == 2
    for name, text in blocks:
        tested = (EXTERNAL / name).read_text(encoding="utf-8")
        for part in text.strip().split("\n\n"):
            for line in part.splitlines():
                assert line in tested, f"{name}: {line}"


@pytest.mark.parametrize("page", PAGES, ids=lambda p: str(p.relative_to(ROOT)))
def test_links_exist(page: Path) -> None:
    for target in re.findall(r"\]\((?!https?:)([^)#]+)\)", page.read_text(encoding="utf-8")):
        assert (page.parent / target).exists(), target
