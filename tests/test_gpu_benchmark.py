"""The GPU benchmark's peer, which is in another environment: what is said where it cannot be had."""

from __future__ import annotations

import stat
import sys
from pathlib import Path

import pytest

sys.path.insert(0, str(Path(__file__).resolve().parents[1] / "benchmarks"))

import mjlab_speed


def python_that(text: str, tmp_path: Path) -> str:
    """A stand-in for the Python of that environment."""
    script = tmp_path / "python"
    script.write_text(f"#!/bin/sh\n{text}\n")
    script.chmod(script.stat().st_mode | stat.S_IXUSR)
    return str(script)


def test_without_mjlab_it_says_what_to_set(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("UNDERSTUDY_MJLAB", raising=False)
    assert "UNDERSTUDY_MJLAB is not set" in str(mjlab_speed.asked([8]))


def test_what_the_other_python_prints_is_read(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> None:
    line = 'echo "a word of its own"; echo "{\\"worlds\\": $3, \\"environment_to_bare\\": 0.5}"'
    monkeypatch.setenv("UNDERSTUDY_MJLAB", python_that(line, tmp_path))
    assert mjlab_speed.asked([8]) == [{"worlds": 8, "environment_to_bare": 0.5}]


@pytest.mark.parametrize(
    ("script", "said"),
    [("echo No module named mjlab >&2; exit 1", "No module named mjlab"), ("exit 3", "no reason")],
)
def test_one_that_fails_is_a_line_and_no_traceback(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path, script: str, said: str
) -> None:
    monkeypatch.setenv("UNDERSTUDY_MJLAB", python_that(script, tmp_path))
    assert said in str(mjlab_speed.asked([8]))


def test_one_that_is_not_there_is_a_line(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("UNDERSTUDY_MJLAB", str(tmp_path / "none"))
    assert "gave nothing" in str(mjlab_speed.asked([8]))
