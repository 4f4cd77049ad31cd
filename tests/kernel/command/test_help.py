"""``--help`` of every command: an example that begins as it does, and how keys are written."""

from __future__ import annotations

import argparse
import shlex

import pytest

from understudy.command.cli import main
from understudy.setup.plugins import installed

NAMES = installed().registry.names("command")


@pytest.mark.parametrize("name", NAMES)
def test_an_example_and_the_keys(name: str, capsys: pytest.CaptureFixture[str]) -> None:
    command = installed().registry.find("command", name).factory()
    with pytest.raises(SystemExit, match="0"):
        main([*name.split(), "--help"])
    said = capsys.readouterr().out
    assert f"for example:\n  {command.example}" in said
    assert f"understudy {name}" in command.example
    assert ("KEY=VALUE" in said) == command.takes_overrides
    if command.takes_overrides:
        assert "[KEY=VALUE …]" in said
        assert "seed=3" in said


@pytest.mark.parametrize("name", NAMES)
def test_what_an_example_leaves_over_sets_something(name: str) -> None:
    """A command that takes no run had an example with one, which it refused."""
    command, parser = (
        installed().registry.find("command", name).factory(),
        argparse.ArgumentParser(),
    )
    command.arguments(parser)
    words = command.example.partition(f"understudy {name}")[2].rstrip(")")  # of a shell's $( … )
    _, left = parser.parse_known_args(shlex.split(words))
    assert [word for word in left if command.takes_overrides and "=" not in word] == []


@pytest.mark.parametrize("name", NAMES)
def test_each_argument_has_a_sentence(name: str) -> None:
    parser = argparse.ArgumentParser()
    installed().registry.find("command", name).factory().arguments(parser)
    said = {action.dest: (action.help or "").strip() for action in parser._actions}
    assert [name for name, text in said.items() if not text or text.startswith("default")] == []
