"""``understudy compare``: finished runs beside one another, and what differs between them, as a page."""

from __future__ import annotations

import argparse
import json
import math
import os
import tempfile
import time
from collections.abc import Iterator, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from understudy import __version__
from understudy.command.command import Command
from understudy.errors import ConfigError, UnderstudyError, shown
from understudy.folders import write_atomically
from understudy.records import runs
from understudy.records.runs import Run
from understudy_report import words
from understudy_report.page import html_page
from understudy_report.values import Row, interval, mapping, number, own_evaluation
from understudy_skills.folder import run_folder
from understudy_sweeps import tables
from understudy_sweeps.film import Tile, make_film
from understudy_sweeps.intervals import paired_difference
from understudy_sweeps.loops import Report, Trial
from understudy_sweeps.page import STYLE, Section, film_html, learning_section
from understudy_sweeps.results import SUCCESS, UNSOUND, Result, Variant, shares_of
from understudy_sweeps.tables import Table

#: Where and how a run was carried out, which is no difference of what was learned.
_OF_THE_RUN = ("run.", "seed")
_MOST = 60  #: characters of a value in a table
_PAIRED = (
    "Differences to {first} are means over the seeds that both have, with their 95 % interval (Student's t): "
    "one without 0 in it is a difference that these seeds show. Two seeds have none."
)
_ONE_SEED = (
    "One seed each: another seed may well change the order. The interval below is over episodes alone, and "
    "tells these two policies apart, not the two ways to train."
)


class Compare(Command):
    """Reads run folders and writes one page, readable offline; the runs are not changed."""

    example = "understudy compare runs/spacetime-walk-001 runs/spacetime-walk-002"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "runs",
            nargs="+",
            metavar="RUN",
            help="two run folders or skills, or more; those that differ in the seed alone are one variant",
        )
        parser.add_argument(
            "--page",
            type=Path,
            default=Path("comparison.html"),
            help="the file to write (%(default)s)",
        )
        parser.add_argument(
            "--no-film", action="store_true", help="leave out the films, which take time"
        )

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.page

    def run(self, options: argparse.Namespace) -> int:
        folders = list(dict.fromkeys(os.path.normpath(run_folder(path)) for path in options.runs))
        if len(folders) < 2:
            raise ConfigError(
                "A comparison is of two runs or more: understudy compare RUN RUN. `understudy runs` lists them."
            )
        opened = [runs.open_run(path) for path in folders]
        variants = variants_among(opened)
        by_path = {str(run.path): run for run in opened}
        firsts = [by_path[str(v.results[0].path)] for v in variants]
        different = differences(firsts)
        table = tables.compared(variants, None)
        print(table.text())
        measures = _measures(variants)
        print(f"\n{measures.text()}\n")
        for text in (*_notes(variants), *_judging(variants)):
            print(shown(text))
        for title, found in different.items():
            print(shown(f"\n{title}"))
            heads = ["", *(v.name for v in variants)]
            print(Table(heads, found).text() if found else "the same")
        sections = [
            Section("Comparison", table=table, notes=[*_notes(variants), *_judging(variants)]),
            Section("Side by side", _film(variants, options.no_film)),
            *learning_section(variants),
            *(
                Section(title, "" if rows else "<p>The same.</p>", _table(variants, rows))
                for title, rows in different.items()
            ),
            Section("All measures", table=measures),
            Section("Runs", table=tables.trials([r for v in variants for r in v.results])),
        ]
        content = "".join(section.html() for section in sections)
        title = " against ".join(v.name for v in variants)
        over = f"understudy compare · {__version__}"
        page = html_page(title, over, time.strftime("%Y-%m-%d %H:%M"), content, STYLE)
        write_atomically(options.page, page)
        print(f"\nThe page is {options.page}.")
        return 0


# ---------------------------------------------------------------------- what is compared


def variants_among(opened: Sequence[Run]) -> list[Variant]:
    """The runs as variants, in their order. Runs whose configurations differ only in the seed are one variant, unless that
    leaves nothing to compare."""
    groups: list[tuple[str, list[Run]]] = []
    for run in opened:
        same = json.dumps(_config(run), sort_keys=True, default=str)
        seeds = {key: [r.config.get("seed") for r in group] for key, group in groups}
        if same in seeds and run.config.get("seed") not in seeds[same]:
            next(group for key, group in groups if key == same).append(run)
        else:
            groups.append((same, [run]))
    if len(groups) == 1:
        groups = [(key, [run]) for key, group in groups for run in group]
    named = _names([group[0].path for _, group in groups])
    return [
        Variant(name, [_result(run, name) for run in group])
        for name, (_, group) in zip(named, groups, strict=True)
    ]


def _config(run: Run) -> dict[str, Any]:
    """The part of the configuration that makes the variant, by key path."""
    return {k: v for k, v in flat(run.config) if not k.startswith(_OF_THE_RUN)}


def _names(paths: Sequence[Path]) -> list[str]:
    """Each folder's name, with as many folders above it as are needed to tell them apart."""
    parts = [path.absolute().parts for path in paths]
    for count in range(1, max(map(len, parts)) + 1):
        names = ["/".join(p[-count:]) for p in parts]
        if len(set(names)) == len(names):
            return names
    return [str(path) for path in paths]


def _result(run: Run, variant: str) -> Result:
    evaluation, rows = own_evaluation(run), run.metrics()
    figures = {
        name: mean
        for name, measure in mapping(evaluation.get("measures")).items()
        if (mean := number(mapping(measure).get("mean"))) is not None
    }
    rate, unsound = number(evaluation.get(SUCCESS)), number(evaluation.get(UNSOUND))
    figures |= {SUCCESS: rate} if rate is not None else {}
    figures |= {UNSOUND: unsound} if unsound else {}
    samples = next((s for row in rows[::-1] if (s := number(row.get("samples"))) is not None), 0.0)
    report = Report(
        str(run.path),
        "ok",
        number(mapping(evaluation.get("objective")).get("value")),
        figures,
        samples,
        str(run.path),
        "finished" if run.judged() is not None else "unfinished",
    )
    seed = run.config.get("seed")
    trial = Trial(str(run.path), variant=variant, seed=seed if isinstance(seed, int) else None)
    return Result(trial, report, run.path, rows, evaluation)


# ---------------------------------------------------------------------- what differs


def differences(opened: Sequence[Run]) -> dict[str, list[list[str]]]:
    """By heading, rows of a key and each run's value, where values differ."""
    code = [
        {
            **{f"code of {k}": v for k, v in mapping(run.info.get("code")).items()},
            **{f"version of {k}": v for k, v in mapping(run.info.get("versions")).items()},
            **dict(flat(mapping(run.info.get("machine")), "machine")),
        }
        for run in opened
    ]
    data = [
        {
            **dict(flat(mapping(run.info.get("sources")))),
            **{
                f"file of {asked}": " ".join(map(str, mapping(files).values()))
                for asked, files in mapping(run.info.get("inputs")).items()
            },
        }
        for run in opened
    ]
    configurations = [_config(run) for run in opened]
    return {
        "What differs in the configuration": _differing(configurations),
        "What differs in the code and the machine": _differing(code),
        "What differs in the data": _differing(data),
    }


def _differing(found: Sequence[Mapping[str, Any]]) -> list[list[str]]:
    keys = dict.fromkeys(key for one in found for key in one)
    nothing = object()
    return [
        [key, *("–" if key not in one else _shown(one[key]) for one in found)]
        for key in keys
        if any(one.get(key, nothing) != found[0].get(key, nothing) for one in found)
    ]


def _shown(value: Any) -> str:
    text = (
        json.dumps(value, ensure_ascii=False, default=str) if not isinstance(value, str) else value
    )
    if len(text) == 64 and set(text) <= set("0123456789abcdef"):
        return text[:12]  # a digest
    return text if len(text) <= _MOST else f"{text[: _MOST - 1]}…"


def flat(value: Any, prefix: str = "") -> Iterator[tuple[str, Any]]:
    """(key path, value) of everything in a nested mapping."""
    if isinstance(value, Mapping) and (value or not prefix):
        for key, item in value.items():
            yield from flat(item, f"{prefix}.{key}" if prefix else str(key))
    else:
        yield prefix, value


def _table(variants: Sequence[Variant], rows: Sequence[Sequence[str]]) -> Table | None:
    return Table(["", *(v.name for v in variants)], rows) if rows else None


# ---------------------------------------------------------------------- how sure it is


def _notes(variants: Sequence[Variant]) -> list[str]:
    if all(len(v.results) == 1 for v in variants):
        return [_ONE_SEED, *_episodes(variants)]
    return [_PAIRED.format(first=variants[0].name)]


def _episodes(variants: Sequence[Variant]) -> list[str]:
    """Of single runs, how much more often each succeeds than the first, over episodes."""
    if any(len(v.results) > 1 for v in variants):
        return []
    first, *others = variants
    found = []
    for other in others:
        between = _difference(first.results[0].evaluation, other.results[0].evaluation)
        if between is not None:
            value, low, high = (100 * v for v in between)
            found.append(
                f"{other.name} succeeds in {value:+.0f} points more of its episodes than {first.name} "
                f"[{low:+.0f}, {high:+.0f}] (95 %, Newcombe, over episodes of one seed each)."
            )
    return found


def _difference(first: Row, second: Row) -> tuple[float, float, float] | None:
    """The success rate of the second evaluation minus that of the first, with Newcombe's (1998, method 10) 95 % interval
    from Wilson's of each."""
    rates = [number(e.get(SUCCESS)) for e in (first, second)]
    bounds = [interval(e.get("success_rate_95")) for e in (first, second)]
    match [*rates, *bounds]:
        case [float(a), float(b), (float(a_low), float(a_high)), (float(b_low), float(b_high))]:
            low = b - a - math.hypot(b - b_low, a_high - a)
            high = b - a + math.hypot(b_high - b, a - a_low)
            return b - a, max(low, -1.0), min(high, 1.0)
    return None


def _judging(variants: Sequence[Variant]) -> list[str]:
    """What was judged differently, so that figures cannot be compared."""
    found = []
    for key, name in (
        ("success", "a success"),
        ("seconds", "an episode in s"),
        ("episodes", "episodes"),
    ):
        seen = dict.fromkeys(
            words.text(r.evaluation[key])
            for v in variants
            for r in v.results
            if r.evaluation.get(key) is not None
        )
        if len(seen) > 1:
            found.append(f"Not judged alike, {name}: {' | '.join(seen)}.")
    if missing := [r.trial.key for v in variants for r in v.results if not r.evaluation]:
        found.append(
            f"Not evaluated as trained: {', '.join(missing)}. `understudy evaluate RUN` does it."
        )
    return found


def _measures(variants: Sequence[Variant]) -> Table:
    """Every measure of every variant, and by how much the others differ from the first, seed by seed."""
    first, *others = variants
    table = tables.all_measures(variants)
    shares = shares_of([r for v in variants for r in v.results])
    rows = [
        [
            *row,
            *(
                tables.shown_mean(
                    paired_difference(first.figures(row[0]), other.figures(row[0])),
                    row[0],
                    sign=True,
                    shares=shares,
                )
                for other in others
            ),
        ]
        for row in table.rows
    ]
    return Table([*table.heads, *(f"{other.name} − {first.name}" for other in others)], rows)


def _film(variants: Sequence[Variant], without: bool) -> str:
    """The first run of each variant side by side, or why there is no film."""
    tiles = [Tile(v.name, v.results[0].path, i) for i, v in enumerate(variants)]
    reason = "it was not asked for"
    if not without:
        try:
            with tempfile.TemporaryDirectory() as folder:
                film = Path(folder) / "film.mp4"
                make_film(film, tiles)
                return film_html(film, tiles)
        except UnderstudyError as error:
            reason = str(error).rstrip(".")
        except Exception as error:  # a scene may come from any plugin
            reason = f"{type(error).__name__}: {error}"
    return f'<p class="failed">There is no video: {escape(reason)}.</p>'
