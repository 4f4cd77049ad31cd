"""A paper's table as data: ``conf/reproduction/PAPER/TABLE.yaml`` of any plugin."""

from __future__ import annotations

import contextlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal

import yaml

from understudy.errors import ConfigError, FileError, suggestion
from understudy.options import make_options
from understudy.setup.plugins import Plugins

__all__ = ["load_table"]

FOLDER = "reproduction"


@dataclass(frozen=True)
class Figure:
    """A number that is read off every trial."""

    #: ``samples``, ``success_rate``, ``objective``, ``seconds``, a measure, or ``metrics/NAME``: a metric's last value.
    of: str
    title: str = ""  #: in words; empty is the name
    share: bool = False  #: whether it is of episodes, and so in per cent, as every success is
    #: Which way is better than the number that the paper prints: verdicts say whether ours is; null gives none.
    better: Literal["less", "more"] | None = None


@dataclass(frozen=True)
class Record:
    """A file of trainings that were run elsewhere: the journal of a sweep, or with ``by`` rows of CSV or JSON."""

    #: what it calls cells, ROW/COLUMN, otherwise
    cells: Mapping[str, str] = field(default_factory=dict)
    less: str = ""  #: in words: how far its trainings fall short of the table's
    by: tuple[str, ...] = ()  #: of a row: the dotted paths of the words that make the cell's name
    values: Mapping[str, str] = field(default_factory=dict)  #: of a row: by figure, its path
    #: of a row: by path, what it must say to count
    where: Mapping[str, str] = field(default_factory=dict)
    seed: str = "seed"  #: of a row: the path of its seed; 0 where it has none

    def __post_init__(self) -> None:
        if bool(self.by) != bool(self.values):
            raise ValueError("by and values belong together.")


@dataclass(frozen=True)
class Printed:
    """What the paper has of a cell, and how it is told whether that holds of ours."""

    says: Any = None  #: its number, or its words
    of: str = ""  #: the figure that is compared; empty is the first
    #: That ours is less, or more, than a number or another cell: a column, a row, or ROW/COLUMN.
    less: float | str | None = None
    more: float | str | None = None

    def __post_init__(self) -> None:
        if self.less is not None and self.more is not None:
            raise ValueError("less and more cannot both be given.")


@dataclass(frozen=True)
class PaperTable:
    """What is trained and compared: every row with every column with every seed.

    A row and a column are overrides; a trial is ``overrides``, then its row's, then its column's. The
    first figure is the one that the paper prints. With ``searches`` those are overrides of whole
    searches, which are compared by the best value found against the samples spent; there are no figures
    then, and no numbers of the paper's.
    """

    title: str
    source: str  #: where the paper has it
    rows: Mapping[str, tuple[str, ...]]
    columns: Mapping[str, tuple[str, ...]] = field(default_factory=lambda: {"ours": ()})
    figures: tuple[Figure, ...] = (Figure("success_rate"),)
    #: By row and column: the number that the paper prints, or its words, alone or as `Printed`.
    paper: Mapping[str, Mapping[str, Any]] = field(default_factory=dict)
    seeds: tuple[int, ...] = (0, 1, 2)
    overrides: tuple[str, ...] = ()
    #: Row and column, ``ROW/COLUMN``, that are left out.
    without: tuple[str, ...] = ()
    deviations: tuple[str, ...] = ()  #: known ones, in a sentence each
    cost: str = ""  #: what all of it takes, in words: samples, minutes, and on what
    needs: str = ""  #: what must be trained before, as a command
    open: str = ""  #: what of it nobody has run yet, in words
    #: By file in the folder of records, docs/benchmarks of a clone: the trainings of this table that are there.
    records: Mapping[str, Record] = field(default_factory=dict)
    #: The command that makes it, where that is not a sweep of ours; the table is then listed and not run.
    command: str = ""
    searches: bool = False  #: whether each cell is a search with an outer loop of its own

    def __post_init__(self) -> None:
        if not self.rows or not self.columns or not self.figures or not self.seeds:
            raise ValueError("rows, columns, figures and seeds must not be empty.")
        for name in (*self.rows, *self.columns):
            if not name.replace("_", "").replace("-", "").replace(".", "").isalnum():
                raise ValueError(
                    f"the name {name!r} has other signs than letters, digits, _, - and ."
                )
        for name in self.records:
            if Path(name).is_absolute() or ".." in Path(name).parts:
                raise ValueError(f"records names '{name}', which is not in the folder of records.")
        for row, cells in self.paper.items():
            unknown = [c for c in cells if c not in self.columns] if row in self.rows else [row]
            if unknown:
                raise ValueError(f"paper names '{unknown[0]}', which is no row or column.")
            for column in cells:
                self.printed(row, column)

    def printed(self, row: str, column: str) -> Printed:
        """What the paper has of a cell; where it has nothing, ``says`` is None."""
        cell = self.paper.get(row, {}).get(column)
        if isinstance(cell, Mapping):
            return make_options(Printed, cell, f"paper.{row}.{column}")
        better = self.figures[0].better
        if better is None or not isinstance(cell, int | float):
            return Printed(cell)
        number = float(cell)
        return Printed(cell, less=number) if better == "less" else Printed(cell, more=number)

    def other(self, name: str, row: str, column: str) -> str:
        """The cell that `row` and `column` have beside them by the `name` of a column, a row, or ROW/COLUMN."""
        return (
            name if "/" in name
            else variant_name(row, name) if name in self.columns
            else variant_name(name, column)
        )  # fmt: skip

    def variants(self) -> dict[str, tuple[str, ...]]:
        """By name: what is trained, row by row."""
        return {
            variant_name(row, column): (*self.rows[row], *self.columns[column])
            for row in self.rows
            for column in self.columns
            if f"{row}/{column}" not in self.without
        }

    def samples(self, row: str, column: str) -> float | None:
        """How many samples a cell's words give each training (``budget.samples``); None if they do not say, or
        in no number."""
        pairs = [
            word.lstrip("+").partition("=")
            for word in (*self.overrides, *self.rows[row], *self.columns[column])
        ]
        given = [value for key, _, value in pairs if key == "budget.samples"]
        with contextlib.suppress(IndexError, ValueError):
            return float(given[-1])
        return None

    def only(self, rows: Sequence[str], columns: Sequence[str], seeds: Sequence[int]) -> PaperTable:
        """The same of these rows, columns and seeds; of all where none are named.

        Raises
        ------
        ConfigError
            there is no such row or column.
        """
        chosen: dict[str, Any] = {"seeds": tuple(seeds) or self.seeds}
        for what, names, all_of in (
            ("rows", rows, self.rows),
            ("columns", columns, self.columns),
        ):
            for name in names:
                if name not in all_of:
                    raise ConfigError(f"--{what}: there is no '{name}'.{suggestion(name, all_of)}")
            chosen[what] = {k: v for k, v in all_of.items() if not names or k in names}
        chosen["paper"] = {
            row: {k: v for k, v in cells.items() if k in chosen["columns"]}
            for row, cells in self.paper.items()
            if row in chosen["rows"]
        }
        return replace(self, **chosen)


def variant_name(row: str, column: str) -> str:
    return f"{row}/{column}"


def table_files(plugins: Plugins) -> dict[str, Path]:
    """Every table that a plugin offers, by name (``spacetime/table_3_1``)."""
    found = {}
    for _, directory in plugins.folders():
        folder = directory / FOLDER
        for file in sorted(folder.rglob("*.yaml")):
            found[file.relative_to(folder).with_suffix("").as_posix()] = file
    return found


def load_table(name: str, plugins: Plugins) -> PaperTable:
    """The table `name`.

    Raises
    ------
    ConfigError
        there is none, or something in it is unknown or of the wrong type.
    FileError
        its file cannot be read.
    """
    files = table_files(plugins)
    if name not in files:
        raise ConfigError(
            f"There is no table '{name}'.{suggestion(name, files)} `understudy reproduce` lists them."
        )
    try:
        raw = yaml.safe_load(files[name].read_text(encoding="utf-8"))
    except (OSError, ValueError, yaml.YAMLError) as error:
        reason = str(error).partition("\n")[0]
        raise FileError(f"{files[name]} is no table: {reason}.") from error
    return make_options(PaperTable, raw, f"{FOLDER}/{name}")
