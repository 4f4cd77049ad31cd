"""The files that surround the code say what the code says."""

from __future__ import annotations

import importlib.util
import re
import shutil
import subprocess
import tomllib
from pathlib import Path
from types import ModuleType

import pytest
import yaml

import understudy
from understudy.setup.plugins import installed
from understudy_inspect.catalogue import offers

ROOT = Path(__file__).resolve().parents[1]


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    released = understudy.__version__.partition("+")[0]  # behind its tag, a commit follows
    assert cited["version"] == released
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)$", changes, re.MULTILINE)[:2] == [
        "Unreleased",
        released,
    ]


def test_forms_and_workflows_can_be_read() -> None:
    files = [*(ROOT / ".github").rglob("*.yml"), ROOT / ".pre-commit-config.yaml"]
    assert len(files) >= 4
    for file in files:
        assert isinstance(yaml.safe_load(file.read_text(encoding="utf-8")), dict), file


def test_commands_of_these_pages_are_targets_of_make() -> None:
    targets = set(
        re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text(encoding="utf-8"), re.MULTILINE)
    )
    for name in ("CONTRIBUTING.md", ".github/pull_request_template.md", ".pre-commit-config.yaml"):
        text = (ROOT / name).read_text(encoding="utf-8")
        assert set(re.findall(r"(?:`|^|: )make ([\w-]+)", text, re.MULTILINE)) <= targets, name


def test_a_new_plugin_is_type_checked_without_a_line() -> None:
    checker = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["tool"]["pyright"]
    assert set(checker["include"]) == {"kernel", "plugins"}
    assert not checker.keys() & {"executionEnvironments", "exclude", "ignore"}
    assert [rule for rule, value in checker.items() if value is False] == [
        "reportMissingModuleSource"
    ]


def test_ci_runs_what_the_workflow_runs() -> None:
    workflow = yaml.safe_load((ROOT / ".github/workflows/ci.yml").read_text(encoding="utf-8"))
    steps = workflow["jobs"]["run"]["steps"]
    assert "bash .ci/run" in [step.get("run") for step in steps]
    supported = re.findall(r"Python :: (3\.\d+)", (ROOT / "pyproject.toml").read_text("utf-8"))
    assert workflow["jobs"]["run"]["strategy"]["matrix"]["python"] == supported


def test_what_the_page_of_ideas_swaps_in_is_there() -> None:
    text = (ROOT / "docs" / "ideas.md").read_text(encoding="utf-8")
    named = re.findall(r"`\+?(\w+)=([\w/]+)` \|$", text, re.MULTILINE)
    assert len(named) > 12
    plugins = installed()
    for group, name in named:
        assert name in {offer.name for offer in offers(plugins, group)}, f"{group}={name}"


@pytest.fixture
def build() -> ModuleType:
    pytest.importorskip("hatchling", reason="hatchling is not installed")
    spec = importlib.util.spec_from_file_location("hatch_build", ROOT / "hatch_build.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def git(folder: Path, *words: str) -> None:
    who = ("-c", "user.name=a", "-c", "user.email=a@b", "-c", "commit.gpgsign=false")
    subprocess.run(["git", *who, *words], cwd=folder, check=True, capture_output=True)


def test_the_version_is_the_tags(build: ModuleType, tmp_path: Path) -> None:
    """Without a tag, the one that is cited; within another repository, not that one's."""
    git(tmp_path, "init", "--quiet")
    git(tmp_path, "commit", "--allow-empty", "--message", "outer")
    git(tmp_path, "tag", "v9.9")
    tree = tmp_path / "tree"
    tree.mkdir()
    (tree / "CITATION.cff").write_text("cff-version: 1.2.0\nversion: 1.2.3\n")
    assert build.version(tree) == "1.2.3"
    git(tree, "init", "--quiet")
    git(tree, "commit", "--allow-empty", "--message", "first")
    assert build.version(tree) == "1.2.3"
    git(tree, "tag", "v1.2.3")
    assert build.version(tree) == "1.2.3"
    git(tree, "commit", "--allow-empty", "--message", "second")
    assert re.fullmatch(r"1\.2\.3\+1\.g[0-9a-f]+", build.version(tree))
    git(tree, "tag", "v1.3.0")
    with pytest.raises(ValueError, match=r"The tag is v1\.3\.0, and CITATION\.cff says 1\.2\.3"):
        build.version(tree)
    (tree / "PKG-INFO").write_text("Name: understudy\nVersion: 1.2.9\n\nVersion: no\n")
    assert build.version(tree) == "1.2.9"
    (tree / "PKG-INFO").unlink()
    shutil.rmtree(tree / ".git")
    assert build.version(tree) == "1.2.3"
