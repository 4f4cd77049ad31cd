"""A package that passes its test at once, from the templates of this plugin."""

from __future__ import annotations

import argparse
import keyword
import re
import shutil
import string
import tempfile
from collections.abc import Iterator
from pathlib import Path

from understudy import __version__
from understudy.command.command import Command
from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed

_TEMPLATES = Path(__file__).parent / "templates"


class NewPlugin(Command):
    """Writes a distribution with one reward, its test, README and entry point."""

    example = "understudy new plugin balance"

    #: Of the templates, later ones replacing files of earlier ones.
    templates: tuple[str, ...] = ("plugin",)

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("name", help="of the plugin: a word, as in `juggling`")
        parser.add_argument("--folder", type=Path, help="where to write; else understudy-NAME")

    def run(self, options: argparse.Namespace) -> int:
        name = checked_name(options.name)
        folder = options.folder or Path(f"understudy-{name.replace('_', '-')}")
        if folder.exists():
            raise FileError(f"{folder} is there already. Name another one: --folder FOLDER.")
        try:
            _write(folder, name, self.templates)
        except OSError as error:
            raise FileError(f"{folder} cannot be written: {error.strerror}.") from error
        print(f"Try it: pip install -e {folder} && pytest {folder}")
        return 0


class NewPaper(Command):
    """Writes a distribution with one reward, an experiment, the paper's page and a table."""

    example = "understudy new paper hopping"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        self._plugin = NewPlugin()
        self._plugin.templates = ("plugin", "paper")
        self._plugin.arguments(parser)

    def run(self, options: argparse.Namespace) -> int:
        return self._plugin.run(options)


def checked_name(name: str) -> str:
    """`name`, if a plugin can be called so.

    Raises
    ------
    ConfigError
        if it is no word of small letters, digits and _, a word of Python, or the name of a plugin.
    """
    if not re.fullmatch(r"[a-z][a-z0-9_]*", name) or keyword.iskeyword(name):
        raise ConfigError(
            f"'{name}' is no name of a plugin. Use small letters, digits and _, as in my_paper."
        )
    if any(plugin.name == name for plugin in installed().loaded):
        raise ConfigError(f"There is a plugin '{name}' already. Use another name.")
    return name


def _write(folder: Path, name: str, templates: tuple[str, ...]) -> None:
    """All files, or none."""
    folder.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix=".", dir=folder.parent) as unfinished:
        for place, text in _files(name, templates):
            file = Path(unfinished) / "all" / place
            file.parent.mkdir(parents=True, exist_ok=True)
            file.write_text(text, encoding="utf-8")
        shutil.move(Path(unfinished) / "all", folder)


def _files(name: str, templates: tuple[str, ...]) -> Iterator[tuple[Path, str]]:
    """Each file's place in the folder, and its text."""
    values = {"name": name, "dashed": name.replace("_", "-"), "version": __version__}
    for template in templates:
        for file in sorted((_TEMPLATES / template).rglob("*.txt")):
            place = file.relative_to(_TEMPLATES / template).with_suffix("")
            text = string.Template(file.read_text(encoding="utf-8")).substitute(values)
            yield Path(str(place).replace("NAME", name)), text
