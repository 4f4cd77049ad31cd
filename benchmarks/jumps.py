"""Diversity searches over real jumps, at equal trials: first whether they can be told apart, then who finds more.

``python benchmarks/jumps.py noise --jobs 14 --minutes 20`` trains take-offs drawn at random, each several times with other seeds of
the training: how many succeed, and how much a measure of the same take-off differs from one training to the next.
``search`` runs Bayesian diversity search, random search and MAP-Elites (pyribs), five seeds each; a trial is ``--repeats``
trainings of its take-off beside each other, whose measures are averaged. Both append every training to a file in
``docs/benchmarks/jumps`` and go on from there, so they may be run in pieces: a training that ``--minutes`` cuts off goes on from
its folder in ``--runs``. ``table`` prints what there is and writes ``summary.jsonl``.

A jump is ``experiment=jumping/high_small`` over 50 cm on one CPU core, of 150 000 samples at most. Strategies are told apart by how the root is turned above
the bar (section 4.6.1), an angle in rad between two rotations.
"""

from __future__ import annotations

import argparse
import contextlib
import datetime
import importlib
import json
import math
import shutil
import time
from collections.abc import Mapping, Sequence
from concurrent.futures import Executor, ProcessPoolExecutor, ThreadPoolExecutor, as_completed
from functools import partial
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import torch
from rows import append

from understudy import random
from understudy.options import make_options
from understudy.records.runs import open_run
from understudy_bayes import draws
from understudy_diversity.strategies import alike, distances, nearest_rotation
from understudy_sweeps.intervals import mean_of
from understudy_sweeps.loops import OuterLoop, Report, Trial, Work
from understudy_sweeps.trial import run_trial

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "jumps"
#: The paper's features of a take-off (the extremes of table 4.3), and the speed of the run-up: too slow a one does not
#: get over the bar.
PARAMETERS = {
    "initial_states.takeoff.forward": {"low": 1.5, "high": 5.2},
    "initial_states.takeoff.v_z": {"low": -2.4, "high": -0.5},
    "initial_states.takeoff.omega_x": {"low": -3.0, "high": 1.0},
    "initial_states.takeoff.omega_z": {"low": -1.0, "high": 1.0},
    "initial_states.takeoff.alpha": {"low": -0.05, "high": 2.09},
}
OVERRIDES = (
    "experiment=jumping/high_small", "difficulty=0.0", "budget.samples=150000",
    "budget.minutes=null", "evaluation.criterion=0.9", "evaluation.every_samples=15000",
    "evaluation.final_episodes=256", "evaluation.objective=cleared_height", "simulator.threads=1",
    "run.video_seconds=0", "checkpoint.minutes=1",
)  # fmt: skip
ROTATION = [f"strategy_{axis}_{i}" for axis in ("forward", "up") for i in "xyz"]
SUCCESS = 0.5  #: share of attempts from which on a take-off shows a strategy
#: Imported where a search runs, since each needs packages (BoTorch, pyribs) that noise and table do without.
LOOPS = {
    "bayesian": "understudy_diversity.search:DiversitySearch",
    "random": "understudy_diversity.search:RandomDiversity",
    "map_elites": "understudy_diversity.map_elites:MapElites",
}


class Jumps:
    """The trainings of one file, made in the processes of `pool` where they are missing."""

    def __init__(self, file: Path, pool: Executor, runs: Path, until: float) -> None:
        self._file, self._pool, self._runs, self._until = file, pool, runs, until
        lines = file.read_text().splitlines() if file.exists() else []
        self._known = {(row["take_off"], row["repeat"]): row for row in map(json.loads, lines)}

    def point(self, take_off: int) -> dict[str, float] | None:
        """Where the take-off of this number was."""
        return next((row["point"] for (n, _), row in self._known.items() if n == take_off), None)

    def train(
        self, take_off: int, seeds: Sequence[int], point: Mapping[str, float]
    ) -> list[dict[str, Any]]:
        """The rows of a take-off's trainings, beside each other, one for each seed; without those that the time cut."""
        missing = {
            self._pool.submit(train, self._runs / f"{self._file.stem}_{take_off}_{i}", seed, point, self._until): i
            for i, seed in enumerate(seeds)
            if (take_off, i) not in self._known
        }  # fmt: skip
        for end in as_completed(missing):
            if (found := end.result()) is None:
                continue
            row = {"take_off": take_off, "repeat": missing[end], **found}
            append(self._file, row)
            self._known[take_off, missing[end]] = row
            shutil.rmtree(self._runs / f"{self._file.stem}_{take_off}_{missing[end]}")
        known = (self._known.get((take_off, i)) for i in range(len(seeds)))
        return [row for row in known if row is not None]


def train(
    folder: Path, seed: int, point: Mapping[str, float], until: float
) -> dict[str, Any] | None:
    """One training, or what is left of it, in `folder`; None where the time cuts it, and it is saved."""
    torch.set_num_threads(1)
    began, report = time.monotonic(), None
    if (folder / "run.json").exists():
        began -= max((row["seconds"] for row in open_run(folder).metrics()), default=0.0)
    trial = Trial(folder.name, point=point, seed=seed)
    reports = run_trial(trial, Work(OVERRIDES, str(folder.parent)))
    with contextlib.closing(reports):
        for report in reports:  # the last counts
            if time.monotonic() > until and not (report and report.final):
                return None
    assert report is not None
    if report.status != "ok":
        raise RuntimeError(report.status)
    return {
        "seed": seed, "point": dict(point), "samples": report.cost,
        "seconds": round(time.monotonic() - began, 1), "measures": dict(report.measures),
    }  # fmt: skip


def averaged(rows: Sequence[dict[str, Any]]) -> dict[str, float]:
    """Measures over trainings of one take-off: of how the root was turned, of those that got over the bar alone."""
    over = [r["measures"] for r in rows if r["measures"]["success_rate"] >= SUCCESS]
    every = [r["measures"] for r in rows]
    mean = {name: math.fsum(m[name] for m in every) / len(every) for name in every[0]}
    for name in ROTATION if over else []:
        mean[name] = math.fsum(m[name] for m in over) / len(over)
    # half of the trainings or more: the take-off shows a strategy
    mean["success_rate"] = float(2 * len(over) >= len(rows))
    return mean


def noise(jumps: Jumps, take_off: int, repeats: int) -> int:
    """How many trainings there are of one take-off, drawn at random."""
    place = draws.uniform(1_000, take_off, len(PARAMETERS))
    point = {
        name: float(bounds["low"] + u * (bounds["high"] - bounds["low"]))
        for (name, bounds), u in zip(PARAMETERS.items(), place, strict=True)
    }
    return len(jumps.train(take_off, range(repeats), point))


def loop_of(name: str, seed: int, trials: int, distinct: float) -> OuterLoop:
    given: dict[str, Any] = {
        "parameters": PARAMETERS,
        "features": {feature: {"low": -1.0, "high": 1.0} for feature in ROTATION},
        "metric": "rotation", "distinct": distinct, "trials": trials, "success": SUCCESS,
    }  # fmt: skip
    given |= {"cells": 4} if name == "map_elites" else {}
    module, _, kind = LOOPS[name].partition(":")
    loop = getattr(importlib.import_module(module), kind)
    return loop(make_options(loop.Options, given, "outer_loop"), seed)


def search(jumps: Jumps, name: str, seed: int, trials: int, repeats: int, distinct: float) -> int:
    """How many trials of one search are finished."""
    loop = loop_of(name, seed, trials, distinct)
    for number in range(trials):
        if (before := jumps.point(number)) is not None:
            trial = Trial(f"trial{number}", point=before)
            loop.recall(trial)
        else:
            asked = loop.ask(number)
            assert asked is not None
            trial = asked
        luck = [random.derive_seed(seed, f"{name}/{number}/{i}") % 2**31 for i in range(repeats)]
        rows = jumps.train(number, luck, trial.point)
        if len(rows) < repeats:
            return number
        measures = averaged(rows)
        cost = sum(row["samples"] for row in rows)
        loop.tell(Report(trial.key, "ok", measures["cleared_height"], measures, cost))
    return trials


# ---------------------------------------------------------------- what they gave


def rows_of(name: str) -> list[dict[str, Any]]:
    path = RESULTS / f"{name}.jsonl"
    return [json.loads(line) for line in path.read_text().splitlines()] if path.exists() else []


def by_take_off(rows: Sequence[dict[str, Any]], repeats: int) -> list[list[dict[str, Any]]]:
    """The trainings of each take-off that has all of its `repeats`."""
    groups: dict[int, list[dict[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["take_off"], []).append(row)
    return [groups[number] for number in sorted(groups) if len(groups[number]) >= repeats]


def rotations_of(measures: Sequence[Mapping[str, float]]) -> torch.Tensor:
    """(n, 6): the axes of the rotations, those that cancel out left out."""
    found = [nearest_rotation([m[name] for name in ROTATION]) for m in measures]
    return torch.tensor([f for f in found if f is not None], dtype=torch.float64).reshape(-1, 6)


def told_apart() -> dict[str, Any]:
    """Of the trainings of take-offs drawn at random: how many succeed, how far the root's rotation is apart between two
    trainings of one take-off, and between two take-offs."""
    names = sorted(path.stem for path in RESULTS.glob("noise_*.jsonl"))
    groups = [rows_of(name) for name in names]
    within, means, mixed = [], [], 0
    for rows in groups:
        over = [r["measures"] for r in rows if r["measures"]["success_rate"] >= SUCCESS]
        mixed += 0 < len(over) < len(rows)
        axes = rotations_of(over)
        if len(axes) >= 2:
            apart = distances(axes, axes, "rotation")
            within += apart[*torch.triu_indices(len(axes), len(axes), 1)].square().tolist()
        if len(axes):
            means.append(rotations_of([averaged(rows)]))
    axes = torch.cat(means) if means else torch.zeros(0, 6, dtype=torch.float64)
    pairs = distances(axes, axes, "rotation")[*torch.triu_indices(len(axes), len(axes), 1)]
    trainings = [row for rows in groups for row in rows]
    good = sum(row["measures"]["success_rate"] >= SUCCESS for row in trainings)
    return {
        "take_offs": len(groups),
        "trainings": len(trainings),
        "succeed": good / max(1, len(trainings)),
        "take_offs_mixed": mixed,
        # two draws differ by √2 standard deviations
        "noise": math.sqrt(sum(within) / len(within) / 2) if within else None,
        "between_take_offs": float(pairs.median()) if len(pairs) else None,
        "samples": sum(row["samples"] for row in trainings),
        "core_minutes": sum(row["seconds"] for row in trainings) / 60,
    }


def compared(
    seeds: Sequence[int], trials: int, repeats: int, distinct: float
) -> list[dict[str, Any]]:
    """A row for each search that is finished: how many strategies it found, which share of those that all searches
    together found, and how many of its take-offs succeeded."""
    finished: dict[tuple[str, int], list[dict[str, float]]] = {}
    for name in LOOPS:
        for seed in seeds:
            groups = by_take_off(rows_of(f"{name}_{seed}"), repeats)
            if len(groups) == trials:
                means = [averaged(rows[:repeats]) for rows in groups]
                finished[name, seed] = [m for m in means if m["success_rate"] >= SUCCESS]
    axes = {key: rotations_of(means) for key, means in finished.items()}
    pooled = torch.cat(list(axes.values())) if axes else torch.zeros(0, 6, dtype=torch.float64)
    kinds, at, rows = alike(pooled, distinct, "rotation"), 0, []
    for (name, seed), own in axes.items():
        shown = set(kinds[at : at + len(own)])
        at += len(own)
        rows.append(
            {
                "search": name,
                "seed": seed,
                "trials": trials,
                "repeats": repeats,
                "distinct": distinct,
                "succeeded": len(own) / trials,
                "found": len(set(alike(own, distinct, "rotation"))),
                "coverage": len(shown) / max(1, len(set(kinds))),
            }
        )
    return rows


def table(seeds: Sequence[int], trials: int, repeats: int, distinct: float) -> None:
    before = {json.dumps(row | {"when": ""}): row["when"] for row in rows_of("summary")}

    def dated(row: dict[str, Any]) -> dict[str, Any]:
        """Today's, or what it was before if it is the same."""
        today = datetime.date.today().isoformat()
        return row | {"when": before.get(json.dumps(row | {"when": ""}), today)}

    lines = [dated({"search": "noise", **told_apart()})]
    print(json.dumps(lines[0], indent=1))
    rows = compared(seeds, trials, repeats, distinct)
    for name in LOOPS:
        own = [row for row in rows if row["search"] == name]
        for what in ("found", "coverage", "succeeded"):
            if (mean := mean_of([float(row[what]) for row in own])) is not None:
                reach = "" if mean.low is None else f" ({mean.low:.2f} to {mean.high:.2f})"
                print(f"{name:11} {what:10} {mean.value:.2f}{reach}, {mean.count} searches")
    lines += map(dated, rows)
    if RESULTS.exists():
        text = "".join(json.dumps(line) + "\n" for line in lines)
        (RESULTS / "summary.jsonl").write_text(text, encoding="utf-8")


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("noise", "search", "table"))
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=20.0, help="then no training goes on")
    parser.add_argument(
        "--runs", type=Path, default=Path("runs/jumps"), help="what is not finished"
    )
    parser.add_argument("--records", type=Path, default=RESULTS, help="what is finished")
    parser.add_argument("--take-offs", type=int, default=28, help="of noise")
    parser.add_argument("--searches", nargs="+", choices=list(LOOPS), default=list(LOOPS))
    parser.add_argument("--seeds", nargs="+", type=int, default=list(range(5)))
    parser.add_argument("--trials", type=int, default=10)
    parser.add_argument("--repeats", type=int, default=3, help="trainings of each take-off")
    parser.add_argument("--distinct", type=float, default=1.2, help="rad, between two strategies")
    given = parser.parse_args()
    until = time.monotonic() + 60 * given.minutes
    if given.what == "table":
        return table(given.seeds, given.trials, given.repeats, given.distinct)
    torch.set_num_threads(1)
    for folder in (given.runs, given.records):
        folder.mkdir(parents=True, exist_ok=True)
    if given.what == "noise":
        files = {
            f"noise_{i}": partial(noise, take_off=i, repeats=given.repeats)
            for i in range(given.take_offs)
        }
    else:
        kind = partial(search, trials=given.trials, repeats=given.repeats, distinct=given.distinct)
        files = {
            f"{name}_{seed}": partial(kind, name=name, seed=seed)
            for seed in given.seeds
            for name in given.searches
        }
    with (
        ProcessPoolExecutor(given.jobs, get_context("forkserver")) as pool,
        ThreadPoolExecutor(len(files)) as waiting,
    ):
        ends = {
            name: waiting.submit(
                work, Jumps(given.records / f"{name}.jsonl", pool, given.runs, until)
            )
            for name, work in files.items()
        }
        for name, end in ends.items():
            print(f"{name}: {end.result()}", flush=True)
    return None


if __name__ == "__main__":
    main()
