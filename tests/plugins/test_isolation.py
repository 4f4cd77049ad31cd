"""Independence: a plugin works with only itself and what it declares; the kernel needs none."""

from __future__ import annotations

import ast
import functools
import importlib
import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
from commands import begin_check
from quick import ELSEWHERE

ROOT = Path(__file__).resolve().parents[2]
FOLDERS = {
    p.name: p for p in (ROOT / "plugins").glob("*/*") if (p / f"understudy_{p.name}").is_dir()
}
NAMES = sorted(FOLDERS)
#: The wings from the bottom up, as their page has them.
WINGS = re.findall(
    r"^\d+\. \[`(\w+)`\]", (ROOT / "plugins" / "README.md").read_text(encoding="utf-8"), re.M
)


#: Plugins for any figure: what their tests and tasks move is the humanoid, with what that needs.
FIGURE = {"networks", "tensors", "humanoid", "characters", "motion", "mujoco"}
#: Plugins for a training that takes seconds.
TOYS = {"curricula", "miniature", "networks", "ppo", "skills", "tensors", "terms"}
#: What every training needs that names no job, and its command.
USUAL = {"reinforcement", "training"}
MATERIAL = {
    "amorphous": {"export", "humanoid"},
    "characters": FIGURE,
    "cmfbo": FIGURE | TOYS | {"deepmimic", "report", "spacetime"},
    "curricula": TOYS,
    "doctor": FIGURE,
    "judging": TOYS,
    "jumping": {"bayes", "diversity", "export", "play", "sweeps"},
    "export": FIGURE | TOYS | {"report", "spacetime", "viewer"},
    "gym": FIGURE | TOYS | {"report", "spacetime"},
    "networks": TOYS,
    "play": FIGURE | TOYS | {"deepmimic", "judging", "sitting", "spacetime", "sweeps"},
    "pose_vae": FIGURE | TOYS | {"retarget", "report", "spacetime", "sweeps"},
    "ray_executor": TOYS | {"report"},
    "retarget": FIGURE,
    "reproduce": TOYS
    | FIGURE
    | {"bayes", "cmfbo", "deepmimic", "morphology", "mujoco_warp", "spacetime", "warp_torch"},
    "sequencing": TOYS,
    "skills": TOYS,
    "spacetime": FIGURE | {"deepmimic", "retarget", "styles"},
    "styles": FIGURE | {"ppo", "report"},
    "sweeps": TOYS,
    "terms": TOYS,
}

#: What their own tests have beside that: the tasks that they train, and the commands that they run with these.
TRIED_WITH = {
    "chopsticks": FIGURE | TOYS | {"mujoco_warp", "play", "report", "sweeps"},
    "deepmimic": {"mujoco_warp", "ray_executor", "sweeps"},
    "diversity": TOYS | {"report", "sweeps"},
    "dressing": FIGURE
    | {
        "amorphous",
        "curricula",
        "deepmimic",
        "mujoco_warp",
        "play",
        "sequencing",
        "spacetime",
        "sweeps",
    },
    "gym": {"deepmimic"},
    "hand": {"chopsticks", "curricula", "gripping", "play", "ppo", "report", "skills", "terms"},
    "imagination": FIGURE | TOYS | {"deepmimic", "report", "spacetime"},
    "judging": FIGURE | {"report", "sitting"},
    "jumping": {"mujoco_warp", "sitting"},
    "motion": {"characters", "humanoid", "mujoco", "tensors"},
    "mujoco": FIGURE | TOYS | {"inspect", "sitting", "spacetime"},
    "networks": {"export", "judging", "play"},
    "ppo": TOYS | FIGURE | {"spacetime"},
    "reinforcement": TOYS | FIGURE | {"inspect", "judging", "play", "report"},
    "reproduce": {"styles"},
    "sitting": {"export", "sequencing", "spacetime"},
    "training": TOYS | FIGURE | {"composite", "sequencing", "sitting", "sweeps"},
}


def requires(name: str) -> set[str]:
    return set(importlib.import_module(f"understudy_{name}").REQUIRES)


@functools.cache
def imported(folder: Path) -> frozenset[str]:
    """The bundled plugins that any module under `folder` imports."""
    found = set()
    for file in folder.rglob("*.py"):
        for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
            modules = []
            if isinstance(node, ast.ImportFrom) and node.module:
                modules = [node.module]
            elif isinstance(node, ast.Import):
                modules = [alias.name for alias in node.names]
            for module in modules:
                head = module.partition(".")[0]
                if head.startswith("understudy_"):
                    found.add(head.removeprefix("understudy_"))
    return frozenset(found)


def test_the_kernel_imports_no_plugin() -> None:
    assert imported(ROOT / "kernel") == set()


@pytest.mark.parametrize("name", NAMES)
def test_imports_only_what_it_declares(name: str) -> None:
    assert imported(FOLDERS[name]) - {name} <= requires(name)


def test_every_wing_has_its_place_and_a_page() -> None:
    assert sorted(WINGS) == sorted({folder.parent.name for folder in FOLDERS.values()})
    for wing in WINGS:
        page = (ROOT / "plugins" / wing / "README.md").read_text(encoding="utf-8")
        assert len(page.splitlines()) <= 40
        own = {name for name in NAMES if FOLDERS[name].parent.name == wing}
        assert {name for name in NAMES if f"]({name}/README.md)" in page} == own


@pytest.mark.parametrize("name", NAMES)
def test_nothing_builds_on_a_higher_wing(name: str) -> None:
    def floor(plugin: str) -> int:
        return WINGS.index(FOLDERS[plugin].parent.name)

    needed = requires(name) | (imported(FOLDERS[name]) - {name})
    assert {other for other in needed if floor(other) > floor(name)} == set()


def test_the_page_has_every_arrow_between_wings() -> None:
    page = (ROOT / "plugins" / "README.md").read_text(encoding="utf-8")
    rows = re.findall(r"^\| `(\w+)` \|(.*)\|$", page, re.M)
    told = {wing: re.findall(r"`(\w+)`", others) for wing, others in rows}
    found: dict[str, set[str]] = {wing: set() for wing in WINGS}
    for name, folder in FOLDERS.items():
        for other in requires(name) | (imported(folder) - {name}):
            found[folder.parent.name].add(FOLDERS[other].parent.name)
    assert told == {wing: [w for w in WINGS if w in found[wing] - {wing}] for wing in WINGS}


def test_declarations_have_no_cycle() -> None:
    def above(name: str, path: tuple[str, ...]) -> None:
        assert name not in path, " → ".join((*path, name))
        for other in requires(name):
            above(other, (*path, name))

    for name in NAMES:
        above(name, ())


@pytest.mark.parametrize("name", NAMES)
def test_works_with_only_what_it_declares(name: str) -> None:
    if name == "mujoco_warp":
        pytest.importorskip("mujoco_warp", reason="MuJoCo Warp is not installed")
    allowed = {name, *requires(name), *MATERIAL.get(name, ()), *USUAL}
    process = begin_check(name, ",".join(allowed))
    process.join(200)
    ended = process.exitcode
    process.kill()
    assert ended == 0


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_its_own_tests_pass_alone(name: str) -> None:
    tests = ROOT / "tests" / "plugins" / ELSEWHERE.get(name, name)
    if not tests.is_dir():
        pytest.skip("it has no tests of its own")
    besides = {*MATERIAL.get(name, ()), *TRIED_WITH.get(name, ()), *USUAL}
    allowed = {name, *requires(name)} | besides
    while not (more := set[str]().union(*map(requires, allowed))) <= allowed:
        allowed |= more
    environment = os.environ | {"UNDERSTUDY_PLUGINS": ",".join(allowed)}
    command = [sys.executable, "-m", "pytest", "-q", str(tests)]
    subprocess.run(command, env=environment, cwd=ROOT, check=True, timeout=600)
