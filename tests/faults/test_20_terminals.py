"""Fault 20: what strangers wrote into a run reaches the terminal as signs to read, never as commands to it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from executors import SMALL_STOP

from understudy.command.cli import main
from understudy.errors import shown

#: Clears a terminal, and renames its window.
COMMANDS = "\x1b[2J\x1b]0;mine\x07\x9b2J"
BAD = {"\x1b", "\x07", "\x9b"}


@pytest.fixture(scope="module")
def trained(tmp_path_factory: pytest.TempPathFactory) -> Path:
    run = tmp_path_factory.mktemp("terminals") / "run"
    assert main(["train", *SMALL_STOP, "run.video_seconds=0", f"run.dir={run}"]) == 0
    return run


def places(value: Any, at: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """Of all that is no mapping and no list."""
    if isinstance(value, dict | list):
        for key, inner in value.items() if isinstance(value, dict) else enumerate(value):
            yield from places(inner, (*at, key))
    else:
        yield at


def put(value: Any, at: tuple[Any, ...], what: Any) -> None:
    for key in at[:-1]:
        value = value[key]
    value[at[-1]] = what


def test_no_part_of_a_run_commands_the_terminal(
    trained: Path, tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    run = tmp_path / "run"
    shutil.copytree(trained, run)
    sound = json.loads((run / "run.json").read_text())
    commands = [("compare", str(trained), str(run), "--no-film", "--overwrite", "--page", str(tmp_path / "c.html")), ("runs", str(tmp_path)),
                ("licence", str(run)), ("cite", str(run))]  # fmt: skip
    for at in list(places(sound))[::7]:
        changed = json.loads(json.dumps(sound))
        put(changed, at, COMMANDS)
        (run / "run.json").write_text(json.dumps(changed))
        for words in commands:
            assert main(words) in (0, 1, 2)
            told = "".join(capfd.readouterr())
            assert not set(told) & BAD, (at, words, told)
    for words in (("resume", str(run)), ("evaluate", str(run)), ("play", str(run), "--no-browser")):
        put(sound, ("config", "policy", "name"), COMMANDS)
        sound["overrides"] = [f"experiment={COMMANDS}"]
        (run / "run.json").write_text(json.dumps(sound))
        assert main(words) == 2
    told = "".join(capfd.readouterr())
    assert "[2J" in told, "it was there to be shown"
    assert not set(told) & BAD


def test_letters_and_lines_stay() -> None:
    assert shown("Größe 日本 🙂\nnext") == "Größe 日本 🙂\nnext"
    assert shown("a\rb\x1b[0m\x00") == "ab[0m"
