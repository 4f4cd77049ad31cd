"""``understudy motion view``: bad input ends in one sentence before anything is served."""

from __future__ import annotations

import importlib.util
import sys
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from understudy.command import cli
from understudy.errors import ConfigError
from understudy.setup import plugins
from understudy_viewer import command, serving
from understudy_viewer.stage import Stage

BUNDLED = ("characters", "humanoid", "motion", "mujoco", "viewer")


class Page:
    """Stands for the page that would be served."""

    served: list[Page] = []
    url = "http://127.0.0.1:1234"

    def __init__(self, stage: Stage, host: str, port: int) -> None:
        self.stage, self.address, self.closed = stage, (host, port), False
        Page.served.append(self)

    def run(self) -> None:
        raise KeyboardInterrupt

    def close(self) -> None:
        self.closed = True


def free_port(host: str, port: int) -> int:
    if host == "elsewhere":
        raise ConfigError("The page cannot be served at elsewhere.")
    return port


@pytest.fixture(autouse=True)
def opened(monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """The addresses that a browser was sent to; the page itself is none."""
    loaded = plugins.load(only=BUNDLED)
    monkeypatch.setattr(plugins, "installed", lambda: loaded)
    monkeypatch.setattr(command, "installed", lambda: loaded)
    found = importlib.util.find_spec
    monkeypatch.setattr(
        importlib.util, "find_spec", lambda name: name if name == "viser" else found(name)
    )
    page: Any = ModuleType("understudy_viewer.page")
    page.Page, page.free_port = Page, free_port
    monkeypatch.setitem(sys.modules, "understudy_viewer.page", page)
    Page.served.clear()
    addresses: list[str] = []
    monkeypatch.setattr(serving.webbrowser, "open", addresses.append)
    return addresses


def test_serves_this_machine_only_until_interrupted(
    opened: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["motion", "view", "walk"]) == 0
    (page,) = Page.served
    assert page.address == ("127.0.0.1", 8080)
    assert page.closed
    assert opened == [Page.url]
    assert capsys.readouterr().out.startswith(f"{Page.url} ")


def test_takes_its_options(opened: list[str]) -> None:
    arguments = ["walk", "walk", "--host", "0.0.0.0", "--port", "90", "--no-browser"]
    assert cli.main(["motion", "view", *arguments]) == 0
    assert Page.served[0].address == ("0.0.0.0", 90)
    assert len(Page.served[0].stage.actors) == 2
    assert opened == []


@pytest.mark.parametrize(
    ("arguments", "reason"),
    [
        (["missing.bvh"], "no such file"),
        (["wlak"], "Did you mean 'walk'"),
        (["walk", "missing.npz"], "no such file"),
        (["walk", "--character", "nobody"], "There is no character 'nobody'"),
        (["{empty}"], "no run folder"),
        (["walk", "--host", "elsewhere"], "cannot be served"),
    ],
)
def test_bad_input_is_one_sentence_and_nothing_is_served(
    arguments: list[str], reason: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    arguments = [word.format(empty=tmp_path) for word in arguments]
    assert cli.main(["motion", "view", *arguments, "--no-browser"]) == 2
    said = capsys.readouterr().err
    assert reason in said
    assert said.count("\n") == 1
    assert Page.served == []


@pytest.mark.parametrize("arguments", [["--port", "65536"], ["--port", "x"], ["--up", "x"], []])
def test_impossible_options_are_refused(arguments: list[str]) -> None:
    assert cli.main(["motion", "view", *(["walk", *arguments] if arguments else [])]) == 2


def test_without_viser_it_says_what_to_install(
    monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setattr(importlib.util, "find_spec", lambda name: None)
    assert cli.main(["motion", "view", "walk"]) == 2
    assert "pip install 'understudy[view]'" in capsys.readouterr().err
