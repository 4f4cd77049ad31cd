"""The files that surround the code say what the code says."""

from __future__ import annotations

import re
from pathlib import Path

import yaml

import understudy
from understudy.setup.plugins import installed
from understudy_inspect.catalogue import offers

ROOT = Path(__file__).resolve().parents[1]


def test_the_citation_is_of_this_version() -> None:
    cited = yaml.safe_load((ROOT / "CITATION.cff").read_text(encoding="utf-8"))
    assert cited["version"] == understudy.__version__
    assert {"cff-version", "message", "title", "authors"} <= cited.keys()
    changes = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")
    assert re.findall(r"^## (.+)$", changes, re.MULTILINE)[:2] == [
        "Unreleased",
        understudy.__version__,
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
        known = {offer.name for offer in offers(plugins, group)} | set(
            plugins.registry.names(group)
        )
        assert name in known, f"{group}={name}"
