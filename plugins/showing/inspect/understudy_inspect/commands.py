"""What there is, as text or JSON.

What composes and builds is imported by the commands that need it: lists of what there is come without torch.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Iterator
from itertools import groupby
from operator import itemgetter
from pathlib import Path
from typing import Any

from understudy.command.command import Command
from understudy.errors import ConfigError, RunError, shown
from understudy.setup.plugins import installed
from understudy_inspect.catalogue import offers

#: What there is, each with what is said of it by name.
Rows = list[dict[str, Any]]


class Listing(Command):
    """Prints the `lines` that say what its `rows` are; or, for programs, the rows as JSON."""

    def __init__(
        self, example: str, rows: Callable[[], Rows], lines: Callable[[Rows], Iterator[str]]
    ) -> None:
        self.example, self._rows, self._lines = example, rows, lines

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--json", action="store_true", help="for programs: JSON")

    def run(self, options: argparse.Namespace) -> int:
        rows = self._rows()
        for line in [json.dumps(rows, indent=1)] if options.json else self._lines(rows):
            print(shown(line))
        return 0


def list_plugins() -> Command:
    """Each plugin with its status and components."""
    return Listing("understudy plugins", _plugins, _plugin_lines)


def list_tasks() -> Command:
    """Each task with its summary and plugin."""
    return Listing("understudy tasks", _tasks, _task_lines)


def list_experiments() -> Command:
    """What ``experiment=…`` can choose, with a line on each, plugin by plugin."""
    return Listing("understudy experiments", _experiments, _experiment_lines)


def _plugins() -> Rows:
    plugins = installed()
    components: dict[str, list[str]] = {}
    for (kind, name), component in sorted(plugins.registry.components.items()):
        components.setdefault(component.plugin, []).append(f"{kind}/{name}")
    return [
        {
            "name": plugin.name,
            "distribution": plugin.distribution,
            "version": plugin.version,
            "status": plugin.status,
            "components": components.get(plugin.name, []),
        }
        for plugin in plugins.loaded
    ]


def _plugin_lines(rows: Rows) -> Iterator[str]:
    for row in rows:
        yield "{name} {version} ({distribution}): {status}".format_map(row)
        yield from (f"  {component}" for component in row["components"])


def _tasks() -> Rows:
    return [vars(task) for _, task in sorted(installed().registry.tasks.items())]


def _task_lines(rows: Rows) -> Iterator[str]:
    width = _width(rows)
    for row in rows:
        yield f"{row['name']:<{width}}  {row['summary']}  [{row['plugin']}]"


def _experiments() -> Rows:
    found = offers(installed(), "experiment")
    return [{"name": o.name, "plugin": o.plugin, "summary": o.summary} for o in found]


def _experiment_lines(rows: Rows) -> Iterator[str]:
    width = _width(rows)
    for plugin, group in groupby(rows, key=itemgetter("plugin")):
        yield plugin
        yield from (f"  {row['name']:<{width}}  {row['summary']}".rstrip() for row in group)
    yield "Train one: understudy train experiment=NAME"


def _width(rows: Rows) -> int:
    return max((len(row["name"]) for row in rows), default=0)


class Describe(Command):
    """A part: what it is, its options with defaults, where they are from; or a file of options."""

    example = "understudy describe learner/ppo"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "part",
            help="what to describe: KIND/NAME, such as learner/ppo or experiment/spacetime/walk; a kind or a plugin alone lists its parts; --observations, --columns and --fields also take a run folder",
        )
        asked = parser.add_mutually_exclusive_group()
        asked.add_argument(
            "--fields",
            action="store_true",
            help="list the state fields, with their shapes, that parts of a task, an experiment or a run can read; KEY=VALUE changes it",
        )
        asked.add_argument(
            "--observations",
            action="store_true",
            help="list the observations of a task, an experiment or a run, how large each is, and what reads it; KEY=VALUE changes it",
        )
        asked.add_argument(
            "--columns",
            action="store_true",
            help="the same, and what each column of an observation is",
        )

    def run(self, options: argparse.Namespace) -> int:
        from understudy_inspect.describe import describe, names, observed, read_by_parts

        plugins, part, words = installed(), options.part, options.overrides
        if words and (joined := "/".join([part, *words])) in names(plugins):
            raise ConfigError(
                f"'{words[0]}' is not taken here. Did you mean `understudy describe {joined}`?"
            )
        seen = options.columns or options.observations
        if words and not (seen or options.fields):
            raise ConfigError(
                f"'{words[0]}' is not taken here: KEY=VALUE goes with --observations, --columns or --fields. "
                "See `understudy describe --help`."
            )
        if seen:
            text = observed(part, plugins, words, columns=options.columns)
        elif options.fields:
            text = read_by_parts(part, plugins, words)
        else:
            text = describe(part, plugins)
        print(shown(text))
        return 0


class ShowConfiguration(Command):
    """Every value of a composed and checked configuration, defaults too, with its origin."""

    example = "understudy config experiment=spacetime/walk learner=trpo"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("--json", action="store_true", help="plain JSON, without origins")

    def run(self, options: argparse.Namespace) -> int:
        from understudy.setup.composition import load_experiment
        from understudy_inspect.origins import all_origins

        experiment = load_experiment(options.overrides)
        effective = experiment.effective()
        if options.json:
            print(json.dumps(effective, indent=1))
            return 0
        origin = all_origins(experiment, options.overrides)
        rows = list(_flat(effective, ""))
        width = min(72, max(len(f"{key}: {value}") for key, value in rows))
        for key, value in rows:
            print(shown(f"{f'{key}: {value}':<{width}}  # {origin[key]}"))
        return 0


class Replay(Command):
    """Repeats the step in which a run's numbers went wrong, from the dump in its ``faults/``."""

    example = "understudy replay runs/spacetime-walk-001"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", help="run folder")

    def run(self, options: argparse.Namespace) -> int:
        dump = Path(options.run) / "faults" / "step"
        if not dump.with_suffix(".json").is_file():
            raise RunError(
                f"{options.run} has no step to repeat: in no run of that name did numbers go wrong (faults/step.json)."
            )
        from understudy_inspect.replay import replay_step

        found = replay_step(dump)
        for world, failed in zip(found.worlds.tolist(), found.failed.tolist(), strict=True):
            print(f"world {world}: {'goes wrong again' if failed else 'stays sound this time'}")
        return 0


def _flat(value: Any, prefix: str) -> Iterator[tuple[str, str]]:
    """(key path, value as JSON) of everything in a nested configuration."""
    if isinstance(value, dict) and value:
        for key, item in value.items():
            yield from _flat(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, json.dumps(value, ensure_ascii=False)
