"""``understudy reproduce PAPER/TABLE``: run what a table compares, and leave its card."""

from __future__ import annotations

import argparse
import re
from pathlib import Path

from understudy.command.command import Command
from understudy.errors import ConfigError, FileError, UnderstudyError
from understudy.folders import check_within
from understudy.setup.composition import compose_raw, replaced
from understudy.setup.plugins import installed
from understudy_reproduce.card import Card
from understudy_reproduce.comparison import Comparison
from understudy_reproduce.owners import belongs_to
from understudy_reproduce.tables import PaperTable, load_table, table_files
from understudy_sweeps.sweep import sweep
from understudy_sweeps.trial import written


class Reproduce(Command):
    """Runs a table's trainings as a sweep: the same command goes on where it was stopped."""

    example = "understudy reproduce spacetime/table_3_1 --rows walk,run --columns bounds --seeds 0"

    takes_overrides = True

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("table", nargs="?", help="PAPER/TABLE; without it, all are listed")
        for name in ("rows", "columns"):
            parser.add_argument(
                f"--{name}", type=_names, default=(), metavar="A,B", help=f"only these {name}"
            )
        parser.add_argument(
            "--seeds", type=_numbers, default=(), metavar="0,1", help="in place of the table's"
        )
        parser.add_argument(
            "--card",
            action="store_true",
            help="train nothing: write card.md of what was trained, in the folder of the table",
        )
        parser.add_argument(
            "--records",
            type=Path,
            metavar="FOLDER",
            help="with the list: where trainings that were run elsewhere are recorded (docs/benchmarks of a clone)",
        )

    def run(self, options: argparse.Namespace) -> int:
        plugins = installed()
        _refuse_what_does_not_go_together(options)
        if options.table is None:
            records = records_of(options.records)
            for name in table_files(plugins):
                try:
                    print("\n    ".join(listed(name, load_table(name, plugins), records)))
                except UnderstudyError as error:
                    print(f"{name} cannot be used: {error}")
            return 0
        whole = load_table(options.table, plugins)
        _refuse_what_is_not_used(options.overrides, card=options.card and not whole.searches)
        table = whole.only(options.rows, options.columns, options.seeds)
        if whole.command:
            raise ConfigError(f"{options.table} is made by another command: {whole.command}")
        folder = _given_folder(options.overrides) or folder_of(options.table)
        with belongs_to(options.table, folder):
            if table.searches:
                card: Comparison | Card = Comparison(
                    options.table, table, folder, options.overrides
                )
                if not options.card:
                    card.run()
            else:
                if not options.card:
                    sweep([*experiment_of(whole), *overrides_of(table, folder, options.overrides)])
                card = Card(options.table, table, folder)
            path = card.write()
        print(card.text())
        print(f"card: {path}")
        return 0


def _refuse_what_does_not_go_together(options: argparse.Namespace) -> None:
    """Raise ConfigError on words that would be left unused: the list is of all tables, and a table has its own card."""
    if options.table is not None and options.records is not None:
        raise ConfigError("--records is of the list of all tables. Leave it or the table out.")
    if options.table is None:
        asked = [
            f"--{name}" for name in ("rows", "columns", "seeds", "card") if getattr(options, name)
        ]
        for word in (*asked, *options.overrides):
            raise ConfigError(f"{word} is of one table: name it, PAPER/TABLE, too.")


def _given_folder(overrides: list[str]) -> Path | None:
    """What ``run.dir`` is among `overrides`, read as everywhere; None without one."""
    given = [override for override in overrides if override.lstrip("+").startswith("run.dir=")]
    named = compose_raw(given)["run"]["dir"] if given else None
    return None if named is None else Path(named)


def _refuse_what_is_not_used(words: list[str], *, card: bool) -> None:
    """Raise ConfigError on words that the table says itself, or that the card of what is there ignores."""
    for word in words:
        key, _, value = word.lstrip("+").partition("=")
        if key in ("rows", "columns", "seeds"):
            plain = re.sub(r"[\[\]{} ]", "", value)
            raise ConfigError(f"{word} is not possible here: write --{key} {plain}.")
        if key in ("experiment", "seed"):
            choice = "--seeds" if key == "seed" else "--rows and --columns"
            raise ConfigError(f"{word} is not possible: the table sets it. Choose by {choice}.")
        if card and key != "run.dir":
            raise ConfigError(
                f"{word} is not possible: --card trains nothing. Leave one of them out."
            )


def folder_of(name: str) -> Path:
    """Where the table `name` is run unless ``run.dir=`` says otherwise."""
    return Path("runs") / "reproduce" / name


def records_of(given: Path | None) -> Path:
    """The folder of records; where none is named, a clone's, which need not be there.

    Raises
    ------
    FileError
        the one that is named is no folder.
    RunError
        something in it leads out of it.
    """
    folder = Path("docs/benchmarks") if given is None else given
    if folder.is_dir():
        check_within(folder)
    elif given is not None:
        raise FileError(f"--records: {given} is no folder. Give the docs/benchmarks of a clone.")
    return folder


def listed(name: str, table: PaperTable, records: Path) -> list[str]:
    """The table in lines: what it is, what of it was run, here or on `records`, what came out, and what it takes."""
    card = Card(name, table, folder_of(name), records)
    lines = [f"{name}: {table.title} ({table.source})", card.state()]
    compared = list(card.compared())
    means = f"{card.what()}: ours are means over seeds [95 % interval] (seeds)"
    lines += [means, *compared] if compared else []
    lines += [f"made by: {table.command}"] if table.command else []
    lines += [f"takes: {table.cost}"] if table.cost else []
    lines += [f"needs first: {table.needs}"] if table.needs else []
    lines += [f"not run yet: {table.open}"] if table.open else []
    return lines


def experiment_of(table: PaperTable) -> list[str]:
    """What options are checked against before any training: the first row's experiment."""
    first = next(iter(table.variants().values()))
    return [o for o in (*table.overrides, *first) if o.startswith("experiment=")][:1]


def overrides_of(table: PaperTable, folder: Path, given: list[str]) -> list[str]:
    """The sweep of `table`: its own overrides, then those of the command line."""
    own = [
        *table.overrides,
        "outer_loop=grid",
        "executor=in_process",
        f"outer_loop.variants={written(table.variants())}",
        f"outer_loop.seeds={written(list(table.seeds))}",
    ]
    return replaced(replaced(own, given), [f"run.dir={written(str(folder))}"])


def _names(text: str) -> tuple[str, ...]:
    names = tuple(part.strip() for part in text.split(","))
    if not all(names):
        what = (
            f"in '{text}' there is none"
            if len(names) > 1
            else "there is none, as of an empty variable"
        )
        raise argparse.ArgumentTypeError(f"a name is needed, and {what}")
    return names


def _numbers(text: str) -> tuple[int, ...]:
    try:
        found = tuple(int(part) for part in _names(text))
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"'{text}' is not possible: whole numbers, as in 0,1"
        ) from None
    for seed in found:
        if not 0 <= seed < 2**63:
            raise argparse.ArgumentTypeError(
                f"{seed} is not possible: seeds are from 0 to 2^63 - 1"
            )
        if found.count(seed) > 1:
            raise argparse.ArgumentTypeError(f"{seed} stands twice, and is trained once")
    return found
