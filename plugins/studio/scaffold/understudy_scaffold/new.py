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
from collections.abc import Iterator, Sequence
from importlib.util import find_spec
from pathlib import Path

from understudy import __version__
from understudy.command.command import Command
from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed

_TEMPLATES = Path(__file__).parent / "templates"
#: Of a template, what belongs to one part of the package.
_BLOCK = re.compile(r"^# >>> ([a-z ]+)\n(.*?)^# <<<\n", re.M | re.S)


#: What a package can begin with; each is a folder of templates, too.
PARTS = ("reward", "observation")


class NewPlugin(Command):
    """Writes a distribution with two rewards and an observation, or with only one of these, with tests, README and entry
    point, and prints what to do next."""

    example = "understudy new plugin balance"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        _where(parser)
        parser.add_argument(
            "--only",
            choices=PARTS,
            help="what the package begins with: rewards (a function and a class) or an observation; both by default",
        )

    def run(self, options: argparse.Namespace) -> int:
        return _begin(options, (options.only,) if options.only else PARTS)


class NewPaper(Command):
    """Writes what `new plugin` writes, and an experiment, the paper's page and a table to reproduce."""

    example = "understudy new paper hopping"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        _where(parser)

    def run(self, options: argparse.Namespace) -> int:
        return _begin(options, PARTS, "paper")


def _where(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("name", help="the plugin's name: one word, such as `juggling`")
    parser.add_argument("--folder", type=Path, help="the folder to write (understudy-NAME)")


def _begin(options: argparse.Namespace, parts: Sequence[str], *more: str) -> int:
    """Write the package with these `parts` and, over it, `more` templates; print what comes next."""
    name = checked_name(options.name)
    folder = options.folder or Path(f"understudy-{name.replace('_', '-')}")
    if folder.exists():
        raise FileError(f"{folder} is there already. Name another one: --folder FOLDER.")
    try:
        _write(folder, name, ("plugin", *parts, *more))
    except OSError as error:
        raise FileError(f"{folder} cannot be written: {error.strerror}.") from error
    print(next_steps(folder, name, (*parts, *more)))
    return 0


def next_steps(folder: Path, name: str, parts: Sequence[str] = PARTS) -> str:
    """What to type now: the commands of this environment, whether or not it is activated. The `parts` are templates."""
    here = Path(sys.executable).parent
    found = shutil.which("pip")
    programs = "" if found and Path(found).parent == here else f"{shlex.quote(str(here))}/"
    alone = _alone()
    testing = "" if find_spec("pytest") else f"{programs}pip install pytest && "
    where = shlex.quote(str(folder))
    program, short = f"{programs}understudy", "budget.samples=20000 run.video_seconds=0"
    train = f"{program} train experiment=spacetime/walk {short}"
    has = {
        "reward": f"two rewards in terms.py, {name}/still, a function, and {name}/high, a class",
        "observation": f"an observation, {name}/height, in encoders.py",
        "paper": f"an experiment, {name}/first, and a table, {name}/table, in conf",
    }
    tries = {
        "reward": [("Train with a reward:", f"{train} 'reward.terms.high={{name: {name}/high}}'")],
        "observation": [(
            "Train with the observation:",
            f"{train} 'encoder.extra={{name: {name}/height}}' 'policy.feedback.observation=[state,extra]'",
        )],
        "paper": [
            ("Train the experiment:", f"{program} train experiment={name}/first {short}"),
            ("Train all of its table:", f"{program} reproduce {name}/table"),
        ],
    }  # fmt: skip
    rows = [
        ("Install and test:", f"{programs}pip install {alone}-e {where} && {testing}{programs}pytest {where}"),
        *(row for part in parts for row in tries[part]),
        ("Write your own:", "beside these or in their place, each with its line in __init__.py and its test"),
        ("What it can read:", f"{program} describe --fields experiment/spacetime/walk"),
    ]  # fmt: skip
    *begun, last = (has[part] for part in parts)
    begun = ";\n".join([*begun, f"and {last}" if begun else last])
    lines = [
        f"{folder}/src/understudy_{name} has {begun}.",
        *(f"{what:<28} {words}" for what, words in rows),
    ]
    return "\n".join(lines)


def _alone() -> str:
    """Options of pip with which nothing is fetched, where what builds the package is there, as for developers."""
    return "--no-build-isolation --no-deps " if find_spec("hatchling") else ""


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
                f"There is a plugin '{name}' already, of {plugin.distribution}. Use another name, or remove "
                f"that plugin: pip uninstall {plugin.distribution}."
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
    values = {
        "name": name, "dashed": name.replace("_", "-"), "version": __version__, "alone": _alone(),
    }  # fmt: skip
    for template in templates:
        for file in sorted((_TEMPLATES / template).rglob("*.txt")):
            place = file.relative_to(_TEMPLATES / template).with_suffix("")
            text = _chosen(file.read_text(encoding="utf-8"), templates)
            filled = string.Template(text).substitute(values)
            yield Path(str(place).replace("NAME", name)), filled


def _chosen(text: str, templates: Sequence[str]) -> str:
    """A template's `text` without the blocks, ``# >>> PART`` to ``# <<<``, of parts that are not among the `templates`;
    ``PART alone`` is a block for packages with no other part."""
    alone = [part for part in PARTS if part in templates]
    known = {*templates, *(f"{part} alone" for part in alone if len(alone) == 1)}
    return _BLOCK.sub(lambda block: block[2] if block[1] in known else "", text)
