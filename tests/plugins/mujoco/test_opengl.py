"""``MUJOCO_GL`` of a library that is not there: training goes on, pictures say what is missing."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

from understudy.errors import UnderstudyError
from understudy_mujoco import opengl

linux = pytest.mark.skipif(sys.platform != "linux", reason="only Linux chooses by MUJOCO_GL")


@pytest.fixture(autouse=True)
def missing(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(opengl, "_LIBRARIES", {"egl": ("libnone.so",), "osmesa": ("libnone.so",)})
    monkeypatch.setattr(opengl, "_missing", "")


def chosen(monkeypatch: pytest.MonkeyPatch, value: str) -> str:
    monkeypatch.setenv("MUJOCO_GL", value)
    opengl.choose()
    return os.environ["MUJOCO_GL"]


@linux
@pytest.mark.parametrize(
    ("value", "word"),
    [("osmesa", "osmesa needs libnone.so"), ("EGL", "egl needs"), ("cairo", "none of egl, osmesa")],
)
def test_what_is_missing_is_named(monkeypatch: pytest.MonkeyPatch, value: str, word: str) -> None:
    assert chosen(monkeypatch, value) == "disable"
    assert word in str(opengl.no_opengl(AttributeError("glGetError")))


@linux
def test_nothing_asked_for_and_nothing_there(monkeypatch: pytest.MonkeyPatch) -> None:
    assert chosen(monkeypatch, "") == "disable"
    assert "libEGL" in str(opengl.no_opengl(AttributeError("GLContext")))


@linux
@pytest.mark.parametrize("value", ["glfw", "off"])
def test_other_settings_are_mujocos(monkeypatch: pytest.MonkeyPatch, value: str) -> None:
    assert chosen(monkeypatch, value) == value


def test_errors_of_the_platform_are_passed_on(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MUJOCO_GL", "egl")
    error = opengl.no_opengl(RuntimeError("no device\nmore"))
    assert isinstance(error, UnderstudyError)
    assert str(error) == "No OpenGL here (no device)."


@linux
def test_tasks_work_without_pictures(tmp_path: Path) -> None:
    result = subprocess.run(
        [sys.executable, "-m", "understudy", "describe", "task/sitting/sit"],
        cwd=tmp_path, env=os.environ | {"MUJOCO_GL": "cairo"}, capture_output=True, text=True,
    )  # fmt: skip
    assert result.returncode == 0, result.stderr
