"""A package that passes its test at once, from the templates of this plugin."""

from __future__ import annotations

import argparse
import keyword
import re
import shlex
import shutil
import string
import sys
import tempfile
from collections.abc import Iterator
from importlib.util import find_spec
from pathlib import Path

from understudy import __version__
from understudy.command.command import Command
from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed

_TEMPLATES = Path(__file__).parent / "templates"


class NewPlugin(Command):
    """Writes a distribution with two rewards and an observation, their tests, README and entry point, and says what comes next."""

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
        print(next_steps(folder, name))
        return 0


class NewPaper(Command):
    """Writes the same, with an experiment, the paper's page and a table."""

    example = "understudy new paper hopping"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        self._plugin = NewPlugin()
        self._plugin.templates = ("plugin", "paper")
        self._plugin.arguments(parser)

    def run(self, options: argparse.Namespace) -> int:
        return self._plugin.run(options)


def next_steps(folder: Path, name: str) -> str:
    """What to type now: the commands of this environment, whether or not it is activated."""
    here = Path(sys.executable).parent
    found = shutil.which("pip")
    programs = "" if found and Path(found).parent == here else f"{shlex.quote(str(here))}/"
    # What builds the package is there in an environment for developers: then nothing is fetched.
    alone = "--no-build-isolation --no-deps " if find_spec("hatchling") else ""
    testing = "" if find_spec("pytest") else f"{programs}pip install pytest && "
    where = shlex.quote(str(folder))
    train = f"{programs}understudy train experiment=spacetime/walk budget.samples=20000 run.video_seconds=0"
    return f"""\
{folder}/src/understudy_{name} has two rewards in terms.py, {name}/still, a function, and {name}/high, a class;
and an observation, {name}/height, in encoders.py.
Install and test:   {programs}pip install {alone}-e {where} && {testing}{programs}pytest {where}
Train by a reward:  {train} 'reward.terms.high={{name: {name}/high}}'
  an observation:   {train} 'encoder.extra={{name: {name}/height}}' 'policy.feedback.observation=[state,extra]'
Write your own:     beside these or in their place, each with its line in __init__.py and its test
What it can read:   {programs}understudy describe --fields experiment/spacetime/walk"""


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
    for plugin in installed().loaded:
        if plugin.name == name:
            raise ConfigError(
                f"There is a plugin '{name}' already, of {plugin.distribution}. Use another name, or take "
                f"that away: pip uninstall {plugin.distribution}."
                if plugin.distribution != "understudy"
                else f"There is a plugin '{name}' already. Use another name."
            )
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
