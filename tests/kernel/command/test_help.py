"""``--help`` of every command: an example that begins as it does, and how keys are written."""

from __future__ import annotations

import argparse

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
def test_each_argument_has_a_sentence(name: str) -> None:
    parser = argparse.ArgumentParser()
    installed().registry.find("command", name).factory().arguments(parser)
    assert [action.dest for action in parser._actions if not action.help] == []
