"""Files of changes have names that a release understands, and a release gathers them; TOML is sorted."""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tomllib
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[1]
CHANGES = ROOT / "changes"
CONFIG = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["tool"]["towncrier"]
TYPES = [kind["directory"] for kind in CONFIG["type"]]
NAME = re.compile(rf"[a-z0-9]+(-[a-z0-9]+)*\.({'|'.join(TYPES)})\.md")
FILES = sorted(file for file in CHANGES.iterdir() if file.name not in CONFIG["ignore"])


@pytest.mark.parametrize("file", FILES, ids=lambda file: file.name)
def test_a_change_has_a_name_of_its_own_and_a_sentence(file: Path) -> None:
    assert NAME.fullmatch(file.name), f"{file.name} is not named as {CHANGES.name}/README.md says"
    text = file.read_text(encoding="utf-8").strip()
    assert text
    assert text[0] not in "-*#", "the release adds the bullet"
    assert "\n\n" not in text, "one paragraph"


@pytest.mark.parametrize(
    "name", ["check.md", "check.new.md", "Check.added.md", "check_runs.added.md", "check.added.txt", ".added.md"]
)  # fmt: skip
def test_other_names_are_refused(name: str) -> None:
    assert not NAME.fullmatch(name)


def test_the_page_names_every_type() -> None:
    page = (CHANGES / "README.md").read_text(encoding="utf-8")
    assert all(f"`{kind}`" in page for kind in TYPES)


def test_a_release_gathers_them(tmp_path: Path) -> None:
    pytest.importorskip("towncrier")
    for name in ("pyproject.toml", "CHANGELOG.md"):
        shutil.copy(ROOT / name, tmp_path)
    shutil.copytree(CHANGES, tmp_path / "changes")
    for name, text in (("b.fixed.md", "A fault is mended."), ("a.added.md", "Something is new.")):
        (tmp_path / "changes" / name).write_text(f"{text}\n", encoding="utf-8")
    before = (ROOT / "CHANGELOG.md").read_text(encoding="utf-8")

    def build(*words: str) -> int:
        command = [sys.executable, "-m", "towncrier", "build", *words]
        return subprocess.run(command, cwd=tmp_path, capture_output=True).returncode

    wrong = tmp_path / "changes" / "c.new.md"
    wrong.write_text("Of no type.\n", encoding="utf-8")
    assert build("--draft", "--version", "next") != 0
    wrong.unlink()
    assert build("--version", "9.9.0", "--date", "2030-01-01", "--yes") == 0
    after = (tmp_path / "CHANGELOG.md").read_text(encoding="utf-8")
    new = after[after.index("## 9.9.0, 2030-01-01") : after.index("## Unreleased")]
    assert re.findall("^### (.*)$", new, re.MULTILINE)[0] == "Added"
    added, fixed = new.index("\n- Something is new.\n"), new.index("\n- A fault is mended.\n")
    assert added < fixed
    assert after.replace(new, "") == before
    assert sorted(p.name for p in (tmp_path / "changes").iterdir()) == sorted(CONFIG["ignore"])


def test_toml_is_sorted(tmp_path: Path) -> None:
    pytest.importorskip("toml_sort")

    def is_sorted(file: Path) -> bool:
        command = [Path(sys.executable).with_name("toml-sort"), "--check", file.name]
        return subprocess.run(command, cwd=file.parent).returncode == 0

    assert is_sorted(ROOT / "pyproject.toml")
    copy = Path(shutil.copy(ROOT / "pyproject.toml", tmp_path))
    copy.write_text(copy.read_text(encoding="utf-8") + "\n[tool.aaa]\nx = 1\n", encoding="utf-8")
    assert not is_sorted(copy)
