"""The figures on the pages, from their records.

``make figures`` writes them; ``python benchmarks/figures.py --check`` says what is not as recorded.

``docs/figures.yaml`` says of what record, in ``docs/benchmarks``, each figure is made; a page has it
between ``<!-- figures: NAME -->`` and ``<!-- /figures -->``. A table of results outside of such a place
says before it from what record it was written by hand, ``<!-- record: FILE, FILE; beside: NUMBERS -->``,
which has each of its numbers but those beside, or why it has none, ``<!-- no record: WHY -->``; one that
only looks so, ``<!-- no result: WHY -->``.
"""

from __future__ import annotations

import argparse
import bisect
import csv
import json
import math
import os
import re
import sys
from collections import Counter, defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import yaml
from scipy import stats

from understudy.setup.plugins import installed
from understudy_reproduce.card import Card
from understudy_reproduce.tables import PaperTable, load_table, table_files
from understudy_sweeps.intervals import (
    FAILS,
    HOLDS,
    ONE,
    UNDECIDED,
    from_below,
    mean_of,
    verdict_between,
)
from understudy_sweeps.intervals import verdict as decided

ROOT = Path(__file__).resolve().parents[1]
RECORDS = ROOT / "docs" / "benchmarks"
PAGES = (
    ROOT / "README.md",
    ROOT / "docs" / "conventions.md",
    ROOT / "docs" / "reproductions.md",
    ROOT / "docs" / "gallery" / "index.md",
    *sorted((ROOT / "docs" / "papers").glob("*.md")),
    RECORDS / "README.md",
)
P = 0.05
VERDICTS = (HOLDS, FAILS, UNDECIDED, ONE)

_PLACE = re.compile(r"(<!-- figures: (\S+) -->)(.*?)(<!-- /figures -->)", re.S)
_TABLE = re.compile(r"((?:^<!--.*?-->\n+)?)((?:^\|.*\n)+)", re.M)
_RESULT = re.compile(
    r"\d ?%|\d ?M\b|± ?\d|\d ?min\b|\d ?J\b|\(\d[\d.]* to \d|\d[^|\[]{0,6} \[[-−+]?\d"
    r"|\d ?(?:k|m|cm|mm|s|ms|rad|°|Hz|m/s)(?=[ ,;)|]|$)"
    r"|\| *[-−]?\d+\.\d+ *(?=\|)"
)
_NUMBER = re.compile(r"(?<![\w.])\d[\d ]*(?:\.\d+)?(?:e\d+)?")
#: What a number on a page may be of one in a record: itself, in per cent, in ms or mm, in k, in M, in minutes.
_SCALES = (1.0, 100.0, 1e3, 1e-3, 1e-6, 1 / 60)
_SETTINGS = re.compile(
    r"\bdefault\b|\boption\b|\bconstant\b|\bdecided\b|^\| paper(?:, thesis)? \| here \||\bwhat \| value\b"
    r"|\bvalue\b.*\b(source|why)\b"
)


# ---------------------------------------------------------------------- records


@dataclass(frozen=True)
class Measured:
    """What a record has of one thing."""

    values: Mapping[int, float]  #: by seed
    #: By seed, how much it is at least, where a criterion was not met.
    missed: Mapping[int, float] = field(default_factory=dict)
    summary: tuple[float, float, int] | None = None  #: mean, half of its 95 % interval, seeds

    @property
    def seeds(self) -> int:
        return self.summary[2] if self.summary else len(self.values) + len(self.missed)

    @property
    def mean(self) -> float:
        known = [*self.values.values()]
        return self.summary[0] if self.summary else sum(known) / len(known)

    def bounded(self) -> Measured:
        """With what is known from below in place of what is not."""
        return self if self.summary else Measured({**self.values, **self.missed})


@cache
def rows(record: str) -> tuple[Mapping[str, Any], ...]:
    """The lines of a record; of a sweep's journal the final reports, with the variant and seed of
    their keys. A line without ``measures`` has them as its own, so that it stands beside reports."""
    with open(RECORDS / record, encoding="utf-8", newline="") as file:
        if record.endswith(".csv"):
            return tuple({**row, "measures": row} for row in csv.DictReader(file))
        lines = [json.loads(line) for line in file]
    found = []
    for line in lines:
        if "event" in line and line["event"] != "finished":
            continue
        row = line["report"] if "event" in line else {"measures": line, **line}
        variant, _, seed = str(row.get("key", "")).rpartition("/seed")
        found.append({"variant": variant, "seed": int(seed), **row} if seed.isdigit() else row)
    return tuple(found)


def records(what: Mapping[str, Any]) -> list[str]:
    """``record`` names one file, or several that go on from each other."""
    named = what["record"]
    return [named] if isinstance(named, str) else named


def lookup(row: Any, path: str) -> Any:
    """What `row` has at a dotted path; None if nothing."""
    for part in path.split("."):
        if isinstance(row, list) and part.isdigit():
            row = row[int(part)] if int(part) < len(row) else None
        else:
            row = row.get(part) if isinstance(row, dict) else None
    return row


def measure(what: Mapping[str, Any]) -> Measured:
    """What the ``record`` has at the path ``value`` of the rows ``where`` paths have given values.

    Rows that ``only`` does not hold of missed it. A seed that is there twice counts as it was last:
    its training went on, or was measured again.

    Raises
    ------
    ValueError
        the record has nothing of it.
    """
    values: dict[int, float] = {}
    missed: dict[int, float] = {}
    there = False
    for number, row in enumerate(row for record in records(what) for row in rows(record)):
        if not _matches(row, what.get("where", {})):
            continue
        there = True
        value, seeds = lookup(row, what["value"]), row.get("seeds")
        if isinstance(value, list) and isinstance(seeds, int):
            return Measured({}, {}, (value[0], value[2] - value[0], seeds))
        if isinstance(value, list):
            values.update(zip(seeds or range(len(value)), map(float, value), strict=True))
        elif value not in (None, ""):
            named = row.get("seed")
            seed = number if named in (None, "") else int(named)
            values.pop(seed, None)
            missed.pop(seed, None)
            (values if _matches(row, what.get("only", {})) else missed)[seed] = float(value)
    if not there:
        where = what.get("where", {})
        raise ValueError(f"{what['record']} has no {what['value']} where {where}.")
    return Measured(values, missed)


def _matches(row: Mapping[str, Any], where: Mapping[str, Any]) -> bool:
    return all(
        lookup(row, path) in (wanted if isinstance(wanted, list) else [wanted])
        for path, wanted in where.items()
    )


# ---------------------------------------------------------------------- verdicts


def verdict(claim: Mapping[str, Any]) -> str:
    """Whether the record bears the claim: two-sided Student's t over seeds, at p < 0.05.

    ``less`` or ``more`` is what it is compared with: a number, or another part of a record, seed by
    seed where both have two or more of the same, else as two samples (Welch). What is known from
    below alone counts as that, where more would only speak louder the same way; else it leaves the
    claim undecided.
    """
    ours = measure(claim)
    better = "less" if "less" in claim else "more"
    other = claim[better]
    if not isinstance(other, Mapping):
        if ours.seeds == 1:
            return ONE
        found = _decided(ours.bounded(), float(other), -1 if better == "less" else 1)
        return from_below(found, better, bool(ours.missed))
    theirs = measure({**claim, **other})
    if min(ours.seeds, theirs.seeds) == 1:
        return ONE
    found = verdict_between(ours.bounded().values, theirs.bounded().values, better)
    return from_below(found, better, bool(ours.missed), bool(theirs.missed))


def _decided(ours: Measured, than: float, sign: int) -> str:
    """Of values that are all known."""
    difference = sign * (ours.mean - than)
    if ours.summary:
        _, reach, count = ours.summary
        error = reach / float(stats.t.ppf(0.975, count - 1))
        return _told(2 * float(stats.t.sf(abs(difference) / error, count - 1)), difference)
    return decided(list(ours.values.values()), than, "less" if sign < 0 else "more")


def _told(p: float, difference: float) -> str:
    return UNDECIDED if not p < P else HOLDS if difference > 0 else FAILS


# ---------------------------------------------------------------------- words


def number(value: float, unit: str) -> str:
    """As a page writes it; `unit` is ``M``, ``k``, ``%``, ``points``, ``mm of m`` or anything that stands behind."""
    if unit == "M":
        return f"{value / 1e6:.2f} M"
    if unit == "k":
        return f"{value / 1e3:.0f} k"
    if unit == "mm of m":
        return number(1e3 * value, "mm")
    if unit == "%1":
        return f"{100 * value:.1f} %"
    if unit == "points":  # of a difference of shares
        return f"{100 * value:+.1f} points"
    if unit == "%":
        share = 100 * value
        return f"{share:.0f} %" if share in (0, 100) or 1 <= share < 99 else f"{share:.1f} %"
    if not unit and value == int(value):
        return f"{value:.0f}"
    digits = 0 if abs(value) >= 100 else 1 if abs(value) >= 10 else 2 if abs(value) >= 1 else 3
    return f"{value:.{digits}f} {unit}".rstrip()


def words(measured: Measured, unit: str) -> str:
    """Mean and its 95 % interval over seeds; one or two seeds by themselves, which have none."""
    values = list(measured.values.values())
    if measured.summary:
        mean, reach, _ = measured.summary
        return f"{number(mean, unit)} ({_range(mean - reach, mean + reach, unit)})"
    text = ", ".join(number(v, unit) for v in values) or ("" if measured.missed else "–")
    if len(values) > 2 and (found := mean_of(values)) is not None:
        found = found.clipped(0.0, 1.0) if unit in ("%", "%1") else found
        text = number(found.value, unit)
        if found.low is not None and found.high is not None and found.high > found.low:
            text += f" ({_range(found.low, found.high, unit)})"
    if measured.missed:
        least = number(min(measured.missed.values()), unit)
        text += f"{'; ' if text else ''}{len(measured.missed)} not within {least}"
    return text


def _range(low: float, high: float, unit: str) -> str:
    sign = "%" if unit == "%1" else "mm" if unit == "mm of m" else unit
    return " to ".join(number(value, unit).removesuffix(sign).strip() for value in (low, high))


_MEANS = "Means and 95 % intervals over seeds (Student's t; one or two seeds by themselves). "


def days(dates: set[str]) -> str:
    """Dates as they stand below a table; those of one month have it once."""
    first, *others = sorted(dates)
    short = [day.removeprefix(first[:8]) for day in others]
    return " and ".join(filter(None, [", ".join([first, *short[:-1]]), *short[-1:]]))


def origin(spec: Mapping[str, Any], used: list[Mapping[str, Any]], seeds: list[int]) -> str:
    """Seeds, hardware, date and file of what was `used`, as they stand below a table.

    Dates are those of the rows that have one (``when``), else as ``docs/figures.yaml`` says; hardware is
    what it says there, else the rows' (``machine``).

    Raises
    ------
    ValueError
        nobody says it, or both say when.
    """
    numbers, links = sorted(set(seeds)), defaultdict(list)
    found: dict[str, list[Mapping[str, Any]]] = {}
    for what in used:
        for record in records(what):
            matched = [row for row in rows(record) if _matches(row, what.get("where", {}))]
            found.setdefault(record, []).extend(matched)
    for record, matched in found.items():
        about = spec["records"].get(record, {})
        dates = {row["when"] for row in matched if "when" in row}
        machines = dict.fromkeys(row["machine"] for row in matched if "machine" in row)
        hardware = about.get("hardware") or "; ".join(machines)
        if dates and "date" in about:
            raise ValueError(
                f"{record}: its rows say when; take its date out of docs/figures.yaml."
            )
        if matched and not (dates or "date" in about):
            raise ValueError(
                f"{record}: docs/figures.yaml must give its date, its rows have no `when`."
            )
        if not hardware:
            raise ValueError(f"{record}: docs/figures.yaml must give its hardware.")
        if matched:
            where = f"{hardware}, {about.get('date') or days(dates)}"
            links[where].append(f"[{record}]({{records}}/{record})")
    lines = [f"{where}: {', '.join(of)}" for where, of in links.items()]
    which = f"Seeds {', '.join(map(str, numbers))}. " if numbers else ""
    return f"{which}{_MEANS}{'; '.join(lines)}."


def table(spec: Mapping[str, Any], one: Mapping[str, Any]) -> str:
    """A table of a record: a row for each of ``rows``, a column for each of ``columns``."""
    printed = one.get("printed", [])
    lines = [[one.get("head", ""), *printed, *(c["title"] for c in one["columns"])]]
    used: list[Mapping[str, Any]] = []
    seeds: list[int] = []
    for name, row in one["rows"].items():
        cells = []
        for column in one["columns"]:
            if "words" in column:
                cells.append(_text({**one, **row}, column["words"]))
                used.append({**one, **row})
                continue
            where = {**column.get("where", {}), **row.get("where", {})}
            what = {"record": one["record"], **column, **row, "where": where}
            found = measure(what)
            used.append(what)
            seeds += [*found.values, *found.missed]
            cells.append(words(found, column.get("in", "")) + _between(what))
        lines.append([name, *map(str, row.get("words", ["–"] * len(printed))), *cells])
    if one.get("exact"):  # nothing was drawn
        return f"{_markdown(lines)}\n\n{origin(spec, used, []).removeprefix(_MEANS)}"
    below = origin(spec, used, [] if one.get("trials") else seeds)
    return f"{_markdown(lines)}\n\n{below.replace('over seeds', 'over trials') if one.get('trials') else below}"


def _text(one: Mapping[str, Any], path: str) -> str:
    """What the first row of the record that `one` chooses says in words."""
    found = (row for record in records(one) for row in rows(record) if _matches(row, one["where"]))
    said = str(lookup(next(found), path))
    return {"True": "yes", "False": "no"}.get(said, said)


def _between(what: Mapping[str, Any]) -> str:
    """The interval that the record itself has, over episodes, of the one row that `what` chooses."""
    if "between" not in what:
        return ""
    (row,) = (row for r in records(what) for row in rows(r) if _matches(row, what["where"]))
    low, high = lookup(row, what["between"])
    return f" ({_range(low, high, what.get('in', ''))})"


def claims(spec: Mapping[str, Any], page: str) -> str:
    """The claims of a page, and what its records say of them."""
    lines = [["claim", "paper", "here", "seeds", "verdict"]]
    used: list[Mapping[str, Any]] = []
    for claim in spec["claims"][page]:
        unit, other = claim.get("in", ""), claim.get("less", claim.get("more"))
        found = measure(claim)
        here = words(found, unit)
        used.append(claim)
        if isinstance(other, Mapping):
            here += f" against {words(measure({**claim, **other}), unit)}"
            used.append({**claim, **other})
        printed = str(claim.get("paper", "–"))
        cells = [claim["claim"], printed, here, str(found.seeds), f"*{verdict(claim)}*"]
        lines.append(cells)
    return f"{_markdown(lines)}\n\n{_HOW}\n\n{origin(spec, used, [])}"


_HOW = (
    "*holds*, *does not hold*: a two-sided Student's t over seeds has p < 0.05; *undecided*: it has "
    "not, or seeds missed a criterion (not within) where that leaves it open; *one seed* tells nothing "
    "of others. Single values are seeds."
)


def told(claim: Mapping[str, Any]) -> str:
    """A claim within a line: its verdict, and what that stands on."""
    unit, other = claim.get("in", ""), claim.get("less", claim.get("more"))
    found = measure(claim)
    if isinstance(other, Mapping):
        theirs = measure({**claim, **other})
        beside, seeds = words(theirs, unit), f"{found.seeds} and {theirs.seeds} seeds"
        seeds = f"{found.seeds} seeds each" if found.seeds == theirs.seeds else seeds
    else:
        beside, seeds = number(float(other), unit), f"{found.seeds} seeds"
    seeds = "" if verdict(claim) == ONE else f"; {seeds}"
    return f"*{verdict(claim)}*: {words(found, unit)} against {beside}{seeds}"


def summary(spec: Mapping[str, Any]) -> str:
    """How many claims of each page have which verdict."""
    lines = [["", *VERDICTS]]
    for page, all_of in spec["claims"].items():
        counts = Counter(verdict(claim) for claim in all_of)
        link = f"[{spec['titles'][page]}]({{docs}}/papers/{page}.md#what-the-records-say)"
        lines.append([link, *(str(counts[v] or "–") for v in VERDICTS)])
    return _markdown(lines)


@cache
def reproductions() -> tuple[tuple[str, PaperTable, Card], ...]:
    """Every table of ``understudy reproduce``, with what is on record."""
    plugins = installed()
    named = ((name, load_table(name, plugins)) for name in table_files(plugins))
    return tuple((name, table, Card(name, table, ROOT / "none", RECORDS)) for name, table in named)


def tables_of_papers() -> str:
    """A line for each table: how much of it is on record, its verdicts, and what is left."""
    lines = [["table", "what", "state", "verdicts", "left", "takes"]]
    for name, table, card in reproductions():
        counts = Counter(said for *_, said in card.verdicts() if said)
        said = ", ".join(f"{counts[v]} {v}" for v in VERDICTS if counts[v])
        what = f"{table.title} ({table.source})"
        cells = [f"`{name}`", what, card.state(), said or "–", table.open or "–", table.cost or "–"]
        lines.append([cell.replace("|", "\\|") for cell in cells])
    return _markdown(lines)


def rows_of_papers() -> str:
    """A line for each cell that a paper has a number or words of, and there is a record of.

    The first of each table says what the numbers are.
    """
    lines = [["table", "row", "paper", "here (seeds)", "verdict"]]
    for name, _, card in reproductions():
        table = f"`{name}`: {card.what()}"
        for row, printed, ours, said in card.verdicts():
            if ours != "–":
                lines.append([table, row, printed, ours, f"*{said}*" if said else "–"])
                table = f"`{name}`"
    return _markdown(lines)


def film(skill: str) -> str:
    """What stands under the film of a skill that ships: what `shipped.py` measured of it."""
    found = [row for row in rows("shipped.jsonl") if row["skill"] == skill]
    if not found:
        raise ValueError(f"shipped.jsonl has no '{skill}'.")
    played, beyond = found[0]["played"], found[0]["beyond"]
    short = f"; beyond what may ship: {beyond}" if beyond != "–" else ""
    return (
        f"feet slide {number(played['slide'], 'm/s')}, {100 * played['sink']:.1f} cm deep in the floor, "
        f"{played['air']:.2f} s in the air, jerk {number(played['jerk'], 'm/s³')}, "
        f"{number(found[0]['success'], '%')} of held-out episodes succeed{short}"
    )


def passing() -> str:
    """How many skills that ship have nothing beyond what may ship, and by what the others have."""
    beyond = [row["beyond"] for row in rows("shipped.jsonl")]
    by = sorted({name for one in beyond if one != "–" for name in one.split(", ")})
    return f"{beyond.count('–')} of {len(beyond)} skills of characters pass, the others are beyond by {', '.join(by)}"


def _markdown(lines: list[list[str]]) -> str:
    head, *body = lines
    return "\n".join(f"| {' | '.join(cells)} |" for cells in (head, ["---"] * len(head), *body))


# ---------------------------------------------------------------------- pages


def load() -> dict[str, Any]:
    """``docs/figures.yaml``."""
    return yaml.safe_load((ROOT / "docs" / "figures.yaml").read_text(encoding="utf-8"))


def figure(spec: Mapping[str, Any], name: str) -> str:
    """What stands at the place `name`: a table, the claims of a page, or a value within a line.

    Raises
    ------
    ValueError
        there is no such figure, or its record has nothing of it.
    """
    kind, _, rest = name.partition("/")
    if name == "claims":
        return f"\n\n{summary(spec)}\n\n"
    if name == "reproductions":
        return f"\n\n{tables_of_papers()}\n\n"
    if name == "reproductions/rows":
        return f"\n\n{rows_of_papers()}\n\n"
    if name == "shipped/passing":
        return passing()
    if kind == "film":
        return film(rest)
    if kind == "claims" and rest in spec["claims"]:
        return f"\n\n{claims(spec, rest)}\n\n"
    if name in spec["tables"]:
        return f"\n\n{table(spec, spec['tables'][name])}\n\n"
    if name in spec["values"]:
        one = spec["values"][name]
        return told(one) if {"less", "more"} & set(one) else words(measure(one), one.get("in", ""))
    raise ValueError(f"there is no figure '{name}' in docs/figures.yaml.")


def written(page: Path, spec: Mapping[str, Any], text: str | None = None) -> str:
    """`page`, or `text` in its place, with every marked place as its record has it."""
    text = page.read_text(encoding="utf-8") if text is None else text
    docs, here = (os.path.relpath(p, page.parent) for p in (ROOT / "docs", RECORDS))

    def write(match: re.Match[str]) -> str:
        what = figure(spec, match[2]).replace("{records}", here).replace("{docs}", docs)
        return f"{match[1]}{what}{match[4]}"

    return _PLACE.sub(write, text)


def untraced(page: Path, text: str | None = None) -> list[str]:
    """The tables of results of `page` that neither are written from a record nor say which one they
    are of, or why they have none."""
    text = page.read_text(encoding="utf-8") if text is None else text
    found = []
    for match in _TABLE.finditer(_PLACE.sub("", text)):
        said, body = match[1].strip(), match[2]
        head = body.partition("\n")[0]
        if not _RESULT.search(body) or _SETTINGS.search(head):
            continue
        record = re.fullmatch(r"<!-- record: (.*?)(?:; beside: (.*))? -->", said)
        if record:
            names, beside = record[1].split(", "), (record[2] or "").split(", ")
            missing = [f"no {name}" for name in names if not (RECORDS / name).exists()]
            found += missing or [f"{head}: {n}" for n in foreign(body, names) if n not in beside]
        elif not re.fullmatch(r"<!-- no (?:record|result): .{10,} -->", said):
            found.append(head)
    return found


def foreign(body: str, names: list[str]) -> list[str]:
    """The numbers of a table's body that none of the records has, as they are rounded there."""
    known = sorted({abs(v) * scale for n in names for v in _numbers(n) for scale in _SCALES})
    strange = []
    for line in body.splitlines()[2:]:
        for match in _NUMBER.finditer(line):
            text = match[0].replace(" ", "")
            mantissa, _, power = text.partition("e")
            digits = len(mantissa.partition(".")[2])
            half = 0.5001 * 10.0 ** (int(power or 0) - digits)
            at = bisect.bisect_left(known, float(text) - half)
            if at == len(known) or known[at] > float(text) + half:
                strange.append(match[0].strip())
    return strange


@cache
def _numbers(record: str) -> frozenset[float]:
    """All numbers in a record, those within its words, and how long its lists are."""
    found: set[float] = set()

    def walk(value: Any) -> None:
        if isinstance(value, Mapping):
            for each in value.values():
                walk(each)
        elif isinstance(value, list | tuple):
            found.add(float(len(value)))
            for each in value:
                walk(each)
        elif isinstance(value, str):
            found.update(map(float, re.findall(r"\d+\.?\d*(?:e-?\d+)?", value)))
        elif isinstance(value, int | float):
            found.add(float(value))

    path = RECORDS / record
    if record.endswith(".csv"):
        walk(rows(record))
    else:  # what a trial reported on its way, too
        walk([json.loads(line) for line in path.read_text(encoding="utf-8").splitlines()])
    return frozenset(v for v in found if math.isfinite(v))


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true", help="change nothing; 1 if it differs")
    options = parser.parse_args()
    spec, status = load(), 0
    for page in PAGES:
        before, after = page.read_text(encoding="utf-8"), written(page, spec)
        name = page.relative_to(ROOT)
        for head in untraced(page):
            print(f"{name}: a table of results without a record: {head}")
            status = 1
        if before != after:
            print(f"{name}: {'differs from its records' if options.check else 'written'}")
            status = max(status, int(options.check))
            if not options.check:
                page.write_text(after, encoding="utf-8")
    return status


if __name__ == "__main__":
    sys.exit(main())
