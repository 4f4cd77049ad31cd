"""The command line: ``understudy COMMAND [OVERRIDES …]``.

Bad input ends with one sentence on standard error and exit status 2; a training told to stop ends
with 75, so that a scheduler can start it again; a defect keeps its traceback.
"""

from __future__ import annotations

import argparse
import contextlib
import os
import signal
import sys
from collections.abc import Sequence
from typing import Any

from understudy import __version__
from understudy.errors import PluginError, PreemptedError, UnderstudyError
from understudy.signals import StopRequest


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit status. Without `arguments`, the process ends with it."""
    own = arguments is None
    with StopRequest(at_once=True, for_good=own) as stop:
        try:
            return _run(list(sys.argv[1:] if own else arguments))
        except (Exception, KeyboardInterrupt) as error:
            if stop.received is not None and not isinstance(error, PreemptedError):
                name = signal.Signals(stop.received).name  # whatever a library made of it
                error = PreemptedError(f"Stopped by {name}. {stop.advice}")
            if isinstance(error, BrokenPipeError):
                sys.stdout = open(os.devnull, "w")  # noqa: SIM115 - the reader went away
                return 0
            if not isinstance(error, UnderstudyError):
                raise
            with contextlib.suppress(OSError):  # the terminal may have been closed
                print(f"understudy: {error}", file=sys.stderr, flush=True)
            return error.exit_status


def _run(arguments: list[str]) -> int:
    parser = _parser(arguments)
    options, overrides = parser.parse_known_args(arguments)
    bad = [item for item in overrides if item.startswith("-")]
    if bad or (overrides and not options.overrides_allowed):
        parser.error(f"unknown argument '{(bad or overrides)[0]}'")
    return options.function(options, overrides)


def _parser(arguments: Sequence[str]) -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(
        prog="understudy",
        description="Simulated characters learn physical skills.",
        epilog="Overrides are Hydra's: experiment=spacetime/walk seed=3 motion.file=clip.txt",
    )
    parser.add_argument("--version", action="version", version=f"understudy {__version__}")
    commands = parser.add_subparsers(metavar="COMMAND", required=True)

    for name, text in (
        ("train", "train an experiment: understudy train experiment=spacetime/walk"),
        ("resume", "continue a training from its last checkpoint"),
        ("evaluate", "evaluate a trained run"),
        ("render", "evaluate a run while recording, and make its report anew"),
    ):
        parser_of = commands.add_parser(name, help=text, description=text)
        parser_of.set_defaults(function=_work, work=name, overrides_allowed=True)
        if name != "train":
            parser_of.add_argument("run", help="run folder")
    _add_plugin_commands(commands, arguments)
    return parser


def _add_plugin_commands(commands: Any, arguments: Sequence[str]) -> None:
    """The commands that plugins register; of these only the one that is asked for is imported."""
    from understudy.setup.plugins import installed

    registry = installed().registry
    groups: dict[str, Any] = {}
    for name in registry.names("command"):
        component = registry.find("command", name)
        *group, word = name.split()
        where = commands
        for first in group[:1]:
            if first not in groups:
                text = f"commands about {first}"
                parser = commands.add_parser(first, help=text, description=text)
                groups[first] = parser.add_subparsers(metavar="COMMAND", required=True)
            where = groups[first]
        if word in where.choices:
            raise PluginError(
                f"Plugin '{component.plugin}' registers the command '{name}', which exists already."
            )
        parser = where.add_parser(word, help=component.summary, description=component.summary)
        if list(arguments[: len(group) + 1]) != [*group, word]:
            continue
        command = component.factory()
        command.arguments(parser)

        def run(options: argparse.Namespace, overrides: list[str], command: Any = command) -> int:
            options.overrides = overrides
            return command.run(options)

        parser.set_defaults(function=run, overrides_allowed=command.takes_overrides)


def _work(options: argparse.Namespace, overrides: list[str]) -> int:
    from understudy.command import workflow

    if options.work == "train":
        return workflow.train(overrides)
    return getattr(workflow, options.work)(options.run, overrides)


if __name__ == "__main__":
    sys.exit(main())
