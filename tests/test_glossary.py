"""The glossary has a row for each word that the kernel and the configuration are made of."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

import understudy.task
from understudy.setup.registry import KERNEL_SLOTS
from understudy.task import Rollout
from understudy_reinforcement.learner import Learner

PAGE = Path(__file__).resolve().parents[1] / "docs" / "conventions.md"


@pytest.fixture(scope="module")
def words() -> list[str]:
    """The words that the glossary's first column defines."""
    text = PAGE.read_text(encoding="utf-8").partition("## Glossary")[2].partition("\n## ")[0]
    rows = [line.split("|")[1] for line in text.splitlines() if line.startswith("| *")]
    return [word for row in rows for word in re.findall(r"\*([^*]+)\*", row)]


def test_each_word_has_one_row(words: list[str]) -> None:
    assert sorted(words) == sorted(set(words))
    assert len(words) > 40


def test_each_kind_of_part_is_explained(words: list[str]) -> None:
    kinds = {slot.kind.replace("_", " ").removesuffix("s") for slot in KERNEL_SLOTS}
    assert kinds - {word.removesuffix("s") for word in words} == set()


def test_each_interface_is_explained(words: list[str]) -> None:
    """But for what is explained where it is used: what actions are made of, and what is handed on."""
    aside = {"ActionSpace", "Box", "Choice", "Context", "Distribution", "Shape", "State", "box"}
    spoken = {re.sub(r"(?<!^)(?=[A-Z])", " ", name).lower() for name in understudy.task.__all__}
    aside = {re.sub(r"(?<!^)(?=[A-Z])", " ", name).lower() for name in aside}
    singular = {word.removesuffix("s") for word in words}
    assert {word.removesuffix("s") for word in spoken - aside} - singular == set()


def test_the_fields_of_a_rollout_are_called_as_the_glossary_says() -> None:
    assert {"fields", "next_fields"} <= set(Rollout.__dataclass_fields__)
    assert Learner.rollout_fields == Learner.next_fields == ()
