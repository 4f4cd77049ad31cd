"""Commands that plugins add to the command line."""

from __future__ import annotations

import argparse
import ast
import errno
import io
import os
import sys
from pathlib import Path

import pytest

from understudy.command import cli
from understudy.command.command import Command, tell
from understudy.errors import FileError
from understudy.setup import plugins
from understudy.setup.registry import Registrar


class Greet(Command):
    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("name")
        parser.add_argument("--loud", action="store_true")

    def run(self, options: argparse.Namespace) -> int:
        if options.name == "nobody":
            raise FileError("There is nobody.")
        print(options.name.upper() if options.loud else options.name)
        return 7


class Greeting:
    @plugins.hookimpl
    def understudy_register(self, register: Registrar) -> None:
        register.component("command", "say hello", Greet, "greet somebody")
        register.component("command", "say lazily", "no_such_module:Nothing", "never works")


@pytest.fixture(autouse=True)
def _greeting(monkeypatch: pytest.MonkeyPatch) -> None:
    loaded = plugins.load(only=[], extra=[("greeting", Greeting())])
    monkeypatch.setattr(plugins, "installed", lambda: loaded)


def test_a_command_gets_its_arguments_and_gives_its_status(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert cli.main(["say", "hello", "Ada", "--loud"]) == 7
    assert capsys.readouterr().out == "ADA\n"


def test_what_the_user_can_cause_is_one_line(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["say", "hello", "nobody"]) == 2
    assert capsys.readouterr().err == "understudy: There is nobody.\n"


@pytest.mark.parametrize("arguments", [["say"], ["say", "hello"], ["say", "hello", "a", "--soft"]])
def test_wrong_arguments_are_refused(
    arguments: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(arguments) == 2
    captured = capsys.readouterr()
    assert (captured.out, captured.err.count("\n")) == ("", 1)
    assert captured.err.startswith("understudy: ")


def test_help_lists_commands_without_importing_them(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as stopped:
        cli.main(["say", "--help"])
    assert stopped.value.code == 0
    shown = capsys.readouterr().out
    assert "greet somebody" in shown
    assert "never works" in shown


def test_a_group_of_commands_says_what_is_in_it(capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        cli.main(["--help"])
    lines = capsys.readouterr().out.splitlines()
    (group,) = (line.split() for line in lines if line.startswith("    say "))
    assert set(" ".join(group[1:]).split(", ")) == {"hello", "lazily"}


def test_a_command_that_cannot_be_imported_says_so(capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["say", "lazily"]) == 2
    assert "cannot be used" in capsys.readouterr().err


def test_a_command_of_a_bundled_name_is_refused() -> None:
    class Taker:
        @plugins.hookimpl
        def understudy_register(self, register: Registrar) -> None:
            register.component("command", "train", Greet, "take over")

    loaded = plugins.load(only=["training"], extra=[("taker", Taker())])
    assert (
        "'training' and plugin 'taker' register the command 'train'"
        in loaded.registry.broken["taker"]
    )
    assert loaded.registry.find("command", "train").plugin == "training"


class Gone(io.StringIO):
    """Standard error whose terminal is gone."""

    def __init__(self, number: int) -> None:
        super().__init__()
        self.number = number

    def write(self, text: str) -> int:
        raise OSError(self.number, os.strerror(self.number))


@pytest.mark.parametrize("stream", [None, Gone(errno.EIO), Gone(errno.EPIPE), Gone(errno.ENOSPC)])
def test_what_nobody_can_be_told_is_not_printed_instead(
    stream: Gone | None, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Where standard error is closed, ``print`` would take standard output, which programs read."""
    monkeypatch.setattr(sys, "stderr", stream)
    tell("hello")
    assert cli.main(["say", "hello", "nobody"]) == 2
    assert capsys.readouterr().out == ""


def test_all_that_plugins_say_is_told() -> None:
    """``print(…, file=sys.stderr)`` would end the work where nobody reads it any more."""
    plugins = Path(__file__).parents[3] / "plugins"
    for file in plugins.rglob("*.py"):
        tree = ast.parse(file.read_text(encoding="utf-8"))
        calls = [node for node in ast.walk(tree) if isinstance(node, ast.Call)]
        printing = [c for c in calls if ast.unparse(c.func) == "print"]
        said = [c for c in printing if any(k.arg == "file" for k in c.keywords)]
        assert not said or file.name == "apart.py", file  # whose process its parent listens to
