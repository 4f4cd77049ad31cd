"""Any part can be swapped into any task by a word: it trains, or one sentence says what is missing."""

from __future__ import annotations

import functools
import os
import re
from collections.abc import Callable
from pathlib import Path
from zlib import crc32

import parts_and_tasks
import pytest
from parts_and_tasks import GIVEN, PAGE, attempt

PLUGINS = parts_and_tasks.bundled()
PARTS = parts_and_tasks.parts(PLUGINS)
TASKS = parts_and_tasks.tasks(PLUGINS)

#: Words of libraries and of Python, which mean nothing to whoever reads a refusal.
_FOREIGN = re.compile(r"hydra|omegaconf|override|traceback|\w+Error|_target_|\bNone\b|<class", re.I)


@pytest.fixture(scope="module")
def tried(built_on: Path) -> Callable[[str, str], str]:
    """What comes of a part in a task."""
    return functools.cache(lambda part, task: attempt(task, part, built_on, PLUGINS))


def assert_clear(refusal: str) -> None:
    """One line that names what does not fit, in the product's own words."""
    assert "\n" not in refusal
    assert not _FOREIGN.search(refusal), refusal
    assert re.search(r"needs|does not fit|is not set", refusal), refusal
    assert refusal.endswith((".", "?"))


#: It begins where other runs of its own figure ended, and the table has none of these.
NEEDS_A_BANK = ("initial_states=sitting/where_others_ended",)


def test_the_page_has_every_part_and_every_task() -> None:
    found = parts_and_tasks.read(PAGE.read_text(encoding="utf-8"))
    assert list(found) == [(part, task) for part in PARTS for task in TASKS], (
        "run `make parts-and-tasks`"
    )
    for part in PARTS:
        refusals = [found[part, task] for task in TASKS]
        assert not all(refusals) or part in NEEDS_A_BANK, f"{part} goes with no task at all"
        for refusal in filter(None, refusals):
            assert_clear(refusal)


#: All of them take a quarter of an hour; these are a share that does not depend on the others.
SOME = [
    (part, task) for part in PARTS for task in TASKS if crc32(f"{part} {task}".encode()) % 24 == 0
]


@pytest.fixture(scope="module")
def on_the_page() -> dict[tuple[str, str], str]:
    return parts_and_tasks.read(PAGE.read_text(encoding="utf-8"))


@pytest.mark.parametrize(("part", "task"), SOME)
def test_the_page_is_right(
    part: str, task: str, tried: Callable[[str, str], str], on_the_page: dict[tuple[str, str], str]
) -> None:
    assert tried(part, task) == on_the_page[part, task], "run `make parts-and-tasks`"


@pytest.mark.slow
def test_the_page_is_up_to_date(tried: Callable[[str, str], str]) -> None:
    found = {(part, task): tried(part, task) for part in PARTS for task in TASKS}
    assert PAGE.read_text(encoding="utf-8") == parts_and_tasks.page(found), (
        "run `make parts-and-tasks`"
    )


@pytest.mark.parametrize("part", GIVEN)
def test_what_is_to_be_given_is_asked_for(part: str, tmp_path: Path) -> None:
    refusal = attempt("miniature/go", part, tmp_path, PLUGINS, more=())
    option = GIVEN[part][0].partition("=")[0]
    assert refusal == f"{option} is not set. Give it a value."


@pytest.mark.parametrize(
    "part",
    ["policy=mlp", "learner=ppo", "learner=trpo", "termination=spacetime",
     "initial_states=spacetime/evolution"],
)  # fmt: skip
@pytest.mark.parametrize("skill", ["run", "cartwheel", "backflip"])
def test_every_recorded_skill_takes_the_parts_of_the_walk(
    skill: str, part: str, tmp_path: Path
) -> None:
    if "UNDERSTUDY_DATA" not in os.environ:
        pytest.skip("no recorded clips: UNDERSTUDY_DATA is not set")
    assert attempt(f"spacetime/{skill}", part, tmp_path, PLUGINS) == ""


@pytest.mark.slow
def test_a_sleeve_is_learned_by_the_papers_learner(tmp_path: Path) -> None:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    assert attempt("dressing/sleeve_small", "learner=trpo", tmp_path, PLUGINS) == ""


def test_a_bound_on_a_clip_is_none_on_a_sleeve(tmp_path: Path) -> None:
    pytest.importorskip("potpourri3d", reason="potpourri3d is not installed")
    refusal = attempt("dressing/sleeve_small", "termination=spacetime", tmp_path, PLUGINS)
    assert_clear(refusal)
    assert "needs a scene of type CharacterScene" in refusal
