"""What ``understudy new`` writes passes at once, as a stranger would try it."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from understudy.command.cli import main

pytest.importorskip("hatchling", reason="building the distribution needs hatchling (dev extra)")


def passed(folder: Path, site: Path) -> str:
    """What pytest says of the package in `folder`, built and installed in `site`."""
    install = [
        sys.executable, "-m", "pip", "install", "--quiet", "--no-index", "--no-deps",
        "--no-build-isolation", "--target", str(site), str(folder),
    ]  # fmt: skip
    subprocess.run(install, check=True, timeout=200)
    done = subprocess.run(
        [sys.executable, "-m", "pytest", "-q", "-p", "no:cacheprovider", str(folder)],
        env=os.environ | {"PYTHONPATH": str(site)}, cwd=folder, capture_output=True, text=True,
        timeout=250, check=False,
    )  # fmt: skip
    assert done.returncode == 0, done.stdout
    return done.stdout


def test_a_new_plugin_passes_at_once(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "plugin", "my_juggling"]) == 0
    assert "pip install -e understudy-my-juggling" in capsys.readouterr().out
    assert "3 passed" in passed(tmp_path / "understudy-my-juggling", tmp_path / "site")


def test_a_new_paper_passes_at_once(tmp_path: Path) -> None:
    assert main(["new", "paper", "thrown", "--folder", str(tmp_path / "a" / "b")]) == 0
    written = tmp_path / "a" / "b"
    assert "5 passed" in passed(written, tmp_path / "site")
    assert (written / "docs" / "thrown.md").is_file()
    texts = [
        f.read_text() for f in written.rglob("*") if f.suffix in (".py", ".md", ".yaml", ".toml")
    ]
    assert not [text for text in texts if "$name" in text or "NAME" in text]


@pytest.mark.parametrize(
    "name", ["Juggling", "../up", "with-dash", "1st", "class", "", "spacetime"]
)
def test_names_that_cannot_be_are_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str], name: str
) -> None:
    monkeypatch.chdir(tmp_path)
    assert main(["new", "plugin", name]) == 2
    assert f"'{name}'" in capsys.readouterr().err
    assert list(tmp_path.iterdir()) == []


def test_what_is_there_stays(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    (tmp_path / "mine").mkdir()
    assert main(["new", "paper", "thrown", "--folder", str(tmp_path / "mine")]) == 2
    assert "is there already" in capsys.readouterr().err
    assert list((tmp_path / "mine").iterdir()) == []
