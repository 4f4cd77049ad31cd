"""The command line: ``understudy COMMAND [OVERRIDES …]``.

Bad input ends with one sentence on standard error and exit status 2; a training told to stop ends
with 75, so that a scheduler can start it again; a defect keeps its traceback.
"""

from __future__ import annotations

import argparse
import errno
import functools
import io
import os
import re
import signal
import sys
import tempfile
import traceback
import warnings
from collections.abc import Sequence
from typing import Any, NoReturn

from understudy import __version__
from understudy.command.command import Command, tell
from understudy.errors import (
    ConfigError,
    FileError,
    PreemptedError,
    UnderstudyError,
    shown,
    suggestion,
)
from understudy.setup import plugins
from understudy.signals import StopRequest

__all__ = ["main"]

_UNPRINTED = (errno.ENOSPC, errno.EDQUOT, errno.EFBIG, errno.EBADF, errno.EIO)  #: no disk or tty
#: Errors by which a file cannot be used at all, not even to find out whether it is there.
_UNUSABLE = (*_UNPRINTED, errno.ENAMETOOLONG, errno.EACCES, errno.EPERM, errno.EROFS, errno.ELOOP)


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status. Without `arguments`, the process ends with it."""
    own = arguments is None
    if own and not os.environ.get("UNDERSTUDY_TRACEBACK"):  # which asks for lines of code
        told = functools.cache(tell)  # each once
        warnings.showwarning = lambda text, *_, **__: told(" ".join(str(text).split()))
    for stream in (sys.stdout, sys.stderr):
        if own and isinstance(stream, io.TextIOWrapper):
            stream.reconfigure(errors="replace")  # a terminal may not have every character
    with StopRequest(at_once=True, for_good=own, tell=tell) as stop:
        try:
            status = _run(list(sys.argv[1:] if own else arguments) or ["--help"])
            if own and sys.stdout is not None:
                sys.stdout.flush()  # here, where an error can still be reported
            return status
        except (Exception, KeyboardInterrupt) as error:
            if stop.received is not None and not isinstance(error, PreemptedError):
                name = signal.Signals(stop.received).name  # whatever error a library made of it
                error = PreemptedError(f"Stopped by {name}. {stop.advice}")
            if isinstance(error, BrokenPipeError):
                sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - the reader is gone
                return 0
            if isinstance(error, OSError) and error.filename is None and error.errno in _UNPRINTED:
                sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - nothing more goes there
                error = FileError(f"What is printed cannot be written: {error.strerror}.")
            if isinstance(error, OSError) and error.filename and error.errno in _UNUSABLE:
                error = FileError(f"{error.filename!s:.100} cannot be used: {error.strerror}.")
            if isinstance(error, FileNotFoundError) and tempfile.tempdir is error.filename is None:
                error = FileError("No folder for temporary files is writable: set TMPDIR to one.")
            if not isinstance(error, UnderstudyError):
                if (fault := plugins.installed().registry.fault_of(error)) is None:
                    raise
                error = fault
            if os.environ.get("UNDERSTUDY_TRACEBACK"):
                traceback.print_exc()
            tell(f"understudy: {error!s:.10000}")  # a message may be long
            return error.exit_status


def _run(arguments: list[str]) -> int:
    try:
        os.getcwd()
    except OSError as error:  # without one, some libraries would end the process
        raise FileError("The working folder is not there any more. Change to another.") from error
    # Names of files that look like options.
    arguments = [f"./{w}" if re.match("-.*[.]", w) and os.path.exists(w) else w for w in arguments]
    parser = _parser(arguments)
    for word in arguments:
        if (held := re.fullmatch(r"(?:.*=)?(<[^<>=]+>)", word)) and not os.path.exists(held[1]):
            raise ConfigError(
                f"{held[1]} in '{word}' stands for your own: write that in its place."
            )
        if re.match(r"[\w.+-]+=['\"]?~(/|$)", word):
            raise ConfigError(
                f"A shell leaves ~ behind = as it is: write {word.replace('~', '$HOME', 1)}."
            )
        if re.fullmatch(r"\+*run\.dir=\s*", word):
            raise ConfigError(f"{word} names no folder, as of an empty variable. Leave it out.")
        if any(path.count("/") > 200 for path in re.split(r"[,\s]", word)):  # pathlib recurses
            raise ConfigError(f"{word:.40} … leads through more than 200 folders. Name another.")
    options, overrides = parser.parse_known_args(arguments)
    _check(overrides, options.overrides_allowed, arguments[0])
    if overrides:
        from understudy.setup.composition import readable

        overrides = [readable(override) for override in overrides]  # in the form for run.json
    return options.function(options, overrides)


def _text(name: str) -> str:
    """The text of the file `name`, which is beside the kernel's options."""
    return (plugins.kernel_conf() / name).read_text(encoding="utf-8")


def _check(words: Sequence[str], overrides_allowed: bool, command: str) -> None:
    """Raise :class:`ConfigError` for `words` that the `command` does not take."""
    for word, following in zip(words, [*words, ""][1:], strict=True):
        key, _, value = word.lstrip("-").partition("=")
        if not overrides_allowed:
            raise ConfigError(f"'{word}' is not taken here. See `understudy {command} --help`.")
        for options, _, instead in (o.partition(": ") for o in _text("hydra.txt").splitlines()):
            if word.partition("=")[0] in options.split():
                raise ConfigError(f"{word} is Hydra's own. {instead}")
        if word.startswith("-"):
            if not value and "=" not in following:
                value = following
            form = f"Write {key}={value}." if value else "Write KEY=VALUE."
            raise ConfigError(
                f"There is no option {word}. {form} See `understudy {command} --help`."
            )


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are one sentence."""

    def error(self, message: str) -> NoReturn:
        if number := re.search(r"invalid (?:_?(int|count)|\w+) value: (.*)", message):
            kind = "whole number" if number[1] else "number"
            message = message.replace(number[0], f"{number[2]} is no {kind}")
        wrong = re.search(r"invalid choice: '(.*?)' \(choose from (.*)\)", message)
        if wrong and message.startswith("argument COMMAND"):
            known = re.findall(r"[\w-]+", wrong[2])
            message = f"There is no command '{wrong[1]}'.{suggestion(wrong[1], known)}"
            raise ConfigError(message + plugins.installed().registry.absent())
        raise ConfigError(f"{message[0].upper()}{message[1:]}. See `{self.prog} --help`.")


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    parser = _Parser(
        "understudy",
        description="Simulated characters learn physical skills. First `train`, then `play` or "
        "open report.html in the run folder.",
        epilog=_text("help.txt"),
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="version", version=f"understudy {__version__}")
    _add_commands(parser.add_subparsers(metavar="COMMAND", required=True), arguments)
    return parser


def _add_commands(commands: Any, arguments: Sequence[str]) -> None:
    """Add the commands of plugins; only the called one is imported and has its arguments."""
    registry = plugins.installed().registry
    groups: dict[str, Any] = {}
    names = registry.names("command")
    for name in [n for n in names if n.split() == list(arguments[: len(n.split())])] or names:
        component = registry.find("command", name)
        *group, word = name.split()
        where = commands
        for first in group[:1]:
            if first not in groups:
                under = [other for other in names if other.split()[0] == first]
                text = ", ".join(other.removeprefix(f"{first} ") for other in under)
                text += f": {component.summary}" if len(under) == 1 else ""
                parser = commands.add_parser(first, **_help(shown(text)))
                groups[first] = parser.add_subparsers(metavar="COMMAND", required=True)
            where = groups[first]
        parser = where.add_parser(word, **_help(shown(component.summary)))
        if list(arguments[: len(group) + 1]) != [*group, word]:
            continue
        with component.guarded("cannot be used"):
            command = component.make(Command)
            command.arguments(parser)
            parser.formatter_class = argparse.RawDescriptionHelpFormatter
            example = f"for example:\n  {command.example}" if command.example else ""
            parser.epilog = example.replace("%", "%%")
            if command.takes_overrides:
                parser.epilog += f"\n\n{_text('help.txt')}"
                if parser.usage is None:
                    usage = parser.format_usage().removeprefix("usage: ").strip()
                    parser.usage = f"{usage} [KEY=VALUE …]"
            if type(command).writes is not Command.writes:
                parser.add_argument("--overwrite", action="store_true", help="replace what exists")
            parser.format_help()  # which fails here, guarded, if a help has a stray per cent sign

        def run(options: argparse.Namespace, overrides: list[str], command: Any = command) -> int:
            options.overrides = overrides
            for path in filter(None, command.writes(options)):
                there = path.is_symlink() or path.exists()
                if there and not (path.is_dir() or (options.overwrite and path.is_file())):
                    how = ", or add --overwrite" if path.is_file() else ""  # not a pipe or device
                    raise FileError(f"{path} is there already. Name another file{how}.")
            return command.run(options)

        parser.set_defaults(function=run, overrides_allowed=command.takes_overrides)


def _help(text: str) -> dict[str, str]:
    """`text` as argparse's help and description, both of which it formats."""
    doubled = text.replace("%", "%%")
    return {"help": doubled, "description": doubled if "%(prog)" in text else text}


if __name__ == "__main__":
    sys.exit(main())
