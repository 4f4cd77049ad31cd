"""Which cheap training tells of the real one: of an easier task, or on coarser physics?

``python benchmarks/fidelities.py train --task jumps --jobs 60 --minutes 9`` trains the take-offs of ``jumps.py`` (the same draws, over 50 cm) on
physics of 120 Hz in place of 300 Hz (`coarse`) and over 20 cm (`easy`); `whole` are as they are, for what they cost on the same machine: what
they come to is on record already (``jumps/noise_*.jsonl``, up to three seeds). ``--task toy`` does so with points of
``search=cmfbo/toy``, physics of one step a period in place of four, and trains them whole by two seeds. Each training is appended to
``docs/benchmarks/fidelities/trainings.jsonl``, and what is there is not made again.

``table`` writes ``summary.jsonl`` beside it: how what a point is worth by each kind of training goes with what it is worth in whole ones
(Spearman's rank correlation), beside how whole ones of other seeds do, and what a kind costs; and the same of the
first trials of figures 6.3 and 6.5, which CMFBO made at z = 0 and GP-UCB at z = 1, from their journals. Worth is equation 6.5's: the
objective × e^(-N / C).
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from statistics import fmean
from typing import Any

import jumps
import torch
from rows import append
from scipy import stats

from understudy.setup.composition import load_experiment
from understudy.setup.plugins import installed
from understudy_bayes import draws
from understudy_bayes.space import Parameter
from understudy_sweeps.journal import Journal
from understudy_sweeps.loops import Report, Trial, Work
from understudy_sweeps.trial import run_trial

BENCHMARKS = Path(__file__).parents[1] / "docs" / "benchmarks"
TRAININGS = BENCHMARKS / "fidelities" / "trainings.jsonl"
SUMMARY = TRAININGS.with_name("summary.jsonl")


@dataclass(frozen=True)
class Task:
    """What is trained, and what each kind of training changes."""

    what: str
    overrides: tuple[str, ...]
    kinds: dict[str, tuple[str, ...]]
    scale: float  #: C of equation 6.5, samples
    seeds: dict[str, int]  #: of each kind


TASKS = {
    "jumps": Task(
        "take-offs over 50 cm",
        jumps.OVERRIDES,
        {"whole": (), "easy": ("arena.height=[0.2,2.0]",), "coarse": ("control.substeps=2",)},
        150_000.0,
        {"whole": 1, "easy": 1, "coarse": 1},
    ),
    "toy": Task(
        "a toy jumper's strength, run-up and learner",
        ("search=cmfbo/toy",),
        {"whole": (), "easy": ("difficulty=0.0",), "coarse": ("control.substeps=1",)},
        40_000.0,
        {"whole": 2, "easy": 1, "coarse": 1},
    ),
}  # fmt: skip
#: Searches of which CMFBO and GP-UCB begin at the same points, and C of equation 6.5 (none in 6.4).
JOURNALS = {
    "a walker's lengths and radii (figure 6.3)": (
        "cmfbo_figure_6_3/morphology/{}/seed0/journal.jsonl",
        math.inf,
    ),
    "the learner's settings of DeepMimic's walk (figure 6.5)": (
        "cmfbo_figure_6_5/walk/{}/seed0/journal.jsonl",
        1e7,
    ),
}


# ---------------------------------------------------------------- trainings


def point_of(task: str, number: int) -> dict[str, float]:
    """The point of this `number`: a take-off on record, or a draw from the space of the toy's search."""
    if task == "jumps":
        return jumps.rows_of(f"noise_{number}")[0]["point"]
    options = load_experiment(TASKS[task].overrides, installed()).need("outer_loop").effective()
    ranges = {name: Parameter(**given) for name, given in options["parameters"].items()}
    place = draws.uniform(2_000, number, len(ranges))
    return {name: one.value(u) for (name, one), u in zip(ranges.items(), place, strict=True)}


def trained() -> list[dict[str, Any]]:
    lines = TRAININGS.read_text(encoding="utf-8").splitlines() if TRAININGS.exists() else []
    return [json.loads(line) for line in lines]


def train(name: str, kind: str, number: int, seed: int, until: float) -> dict[str, Any] | None:
    """The row of one training, None where the time was over."""
    torch.set_num_threads(1)
    task, report, began = TASKS[name], None, time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        trial = Trial("trial", point=point_of(name, number), seed=seed)
        for report in run_trial(trial, Work((*task.overrides, *task.kinds[kind]), folder)):  # noqa: B007  the last counts
            if time.monotonic() > until:
                return None
    assert report is not None
    if report.status != "ok":
        raise RuntimeError(report.status)
    return {
        "when": time.strftime("%Y-%m-%d"), "task": name, "kind": kind, "point": number, "seed": seed,
        "samples": report.cost, "core_seconds": round(time.process_time() - began, 1),
        "objective": report.objective, "success_rate": report.measures["success_rate"],
    }  # fmt: skip


# ---------------------------------------------------------------- what they tell


def worth(objective: float, samples: float, scale: float) -> float:
    """Equation 6.5's y."""
    return objective * math.exp(-samples / scale)


def related(cheap: Sequence[float], whole: Sequence[float]) -> dict[str, Any]:
    """How alike the order of the points is by each."""
    rank: Any = stats.spearmanr(cheap, whole)
    best = max(range(len(cheap)), key=cheap.__getitem__)
    return {
        "points": len(cheap),
        "rank": float(rank.statistic),
        "p": float(rank.pvalue),
        # the point that the cheap trainings would choose: its worth in whole ones, of the best there is
        "chosen": whole[best] / max(whole),
    }


def of_task(name: str) -> list[dict[str, Any]]:
    """A row for each kind, and one of whole trainings by others."""
    task = TASKS[name]
    by_kind: dict[str, dict[int, list[dict[str, Any]]]] = {}
    for row in trained():
        if row["task"] == name:
            by_kind.setdefault(row["kind"], {}).setdefault(row["point"], []).append(row)

    def value(row: dict[str, Any]) -> float:
        return worth(row["success_rate"], row["samples"], task.scale)

    real: dict[int, list[float]] = {}
    if name == "jumps":
        for number in range(28):
            on_record = jumps.rows_of(f"noise_{number}")
            real[number] = [value({**r, **r["measures"]}) for r in on_record]
    else:
        real = {n: [value(r) for r in rows] for n, rows in by_kind.get("whole", {}).items()}
    own = by_kind.get("whole", {})
    pace = seconds_per_sample([row for rows in own.values() for row in rows])
    found = []
    for kind in ("easy", "coarse"):
        points = [n for n in by_kind.get(kind, {}) if n in real]
        if len(points) < 4:
            continue
        rows = [by_kind[kind][n][0] for n in points]
        answer = related([value(row) for row in rows], [fmean(real[n]) for n in points])
        samples = fmean(row["samples"] for row in rows)
        whole = fmean(whole_samples(name, n, own) for n in points)
        answer |= {"samples": samples, "cost_in_samples": samples / whole}
        if pace:
            answer["cost_in_seconds"] = fmean(r["core_seconds"] for r in rows) / (whole * pace)
        found.append({"of": "kind", "task": task.what, "kind": kind, **answer})
    seeds = [worths for worths in real.values() if len(worths) >= 2]
    if len(seeds) >= 4:
        answer = related([w[0] for w in seeds], [fmean(w[1:]) for w in seeds])
        found.append({"of": "kind", "task": task.what, "kind": "whole, of another seed", **answer})
    return found


def seconds_per_sample(rows: Sequence[dict[str, Any]]) -> float:
    return sum(r["core_seconds"] for r in rows) / sum(r["samples"] for r in rows) if rows else 0.0


def whole_samples(name: str, number: int, own: dict[int, list[dict[str, Any]]]) -> float:
    """What whole trainings of a point took, in the mean of their seeds."""
    rows = jumps.rows_of(f"noise_{number}") if name == "jumps" else own[number]
    return fmean(row["samples"] for row in rows)


def of_journals() -> list[dict[str, Any]]:
    """The first points of two searches: by CMFBO at z = 0, by GP-UCB at z = 1, one training of each."""
    found = []
    for what, (path, scale) in JOURNALS.items():
        easy, whole = (reports(path.format(name)) for name in ("cmfbo", "gp_ucb"))
        both = [(one, whole[place]) for place, one in easy.items() if place in whole]
        values = [[worth(r.objective or 0.0, r.cost, scale) for r in pair] for pair in both]
        samples = [fmean(pair[i].cost for pair in both) for i in range(2)]
        answer = related(*zip(*values, strict=True))
        answer |= {"samples": samples[0], "cost_in_samples": samples[0] / samples[1]}
        found.append({"of": "kind", "task": what, "kind": "easy", **answer})
    return found


def reports(path: str) -> dict[str, Report]:
    """The last reports of the trials that a search began with, by their points."""
    journal = Journal.read(BENCHMARKS / path)
    asked = [event for event in journal.events if isinstance(event, Trial)]
    return {
        json.dumps(dict(trial.point), sort_keys=True): journal.finished[trial.key]
        for trial in asked
        if trial.key in journal.finished and trial.fidelity in (0.0, None)
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("what", choices=("train", "table"))
    parser.add_argument("--task", choices=list(TASKS), default="jumps")
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--minutes", type=float, default=20.0, help="then no training goes on")
    parser.add_argument("--points", type=int, default=28)
    parser.add_argument("--kinds", nargs="+", choices=("whole", "easy", "coarse"))
    given = parser.parse_args()
    if given.what == "table":
        when = {"when": time.strftime("%Y-%m-%d")}
        found = [*of_journals(), *(row for name in TASKS for row in of_task(name))]
        rows = [{**row, **when} for row in found]
        SUMMARY.parent.mkdir(parents=True, exist_ok=True)
        SUMMARY.write_text("".join(json.dumps(row) + "\n" for row in rows), encoding="utf-8")
        print(SUMMARY.read_text(encoding="utf-8"), end="")
        return
    task, until = TASKS[given.task], time.monotonic() + 60 * given.minutes
    known = {(r["task"], r["kind"], r["point"], r["seed"]) for r in trained()}
    jobs = [
        (given.task, kind, number, seed)
        for number in range(given.points)
        for kind in given.kinds or task.kinds
        for seed in range(task.seeds[kind])
    ]
    TRAININGS.parent.mkdir(parents=True, exist_ok=True)
    with ProcessPoolExecutor(given.jobs, mp_context=get_context("spawn")) as pool:
        waiting = [pool.submit(train, *job, until) for job in jobs if job not in known]
        for future in as_completed(waiting):
            if (found := future.result()) is not None:
                append(TRAININGS, found)


if __name__ == "__main__":
    main()
