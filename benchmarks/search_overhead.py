"""What a search takes besides its trials: asks, journal, pages and the video, with no training.

``python benchmarks/search_overhead.py`` carries out ``search=cmfbo/morphology`` with 60 trials (12
parameters) by the sweep itself, with the run folder of one short training in place of all trials, its
metrics repeated up to the samples that a trial is said to have taken. What is left is the sweep's own
time; it is compared with trials of the lengths that were recorded on a GPU, and a line goes to
``docs/benchmarks/search_overhead.jsonl``.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import os
import platform
import shutil
import tempfile
import time
from collections import defaultdict
from collections.abc import Callable, Generator
from pathlib import Path
from typing import Any

import torch
from rows import append

import understudy_sweeps.in_process
from understudy.command.cli import main
from understudy_cmfbo.cmfbo import CMFBO
from understudy_sweeps.loops import Report, Trial, Work
from understudy_sweeps.page import Page
from understudy_sweeps.sweep import sweep
from understudy_sweeps.trial import folder_of

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "search_overhead.jsonl"
TRIALS = 60
#: Seconds of training alone, on an NVIDIA H200; building and evaluating are not counted.
RECORDED = {
    "morphology, full help, 3.4 M samples (docs/papers/morphology.md)": 36.0,
    "DeepMimic's walk, criterion after 3.05 M samples (docs/papers/deepmimic.md)": 57.0,
}
#: Rows of metrics of a trial: iterations of 8192 samples.
_ITERATION = 8192

_spent: dict[str, float] = defaultdict(float)


def timed(label: str, function: Callable[..., Any]) -> Callable[..., Any]:
    def wrapped(*args: Any, **options: Any) -> Any:
        began = time.process_time()
        try:
            return function(*args, **options)
        finally:
            _spent[label] += time.process_time() - began

    return wrapped


def replayed(model: Path) -> Callable[[Trial, Work], Generator[Report | None, bool | None, None]]:
    """In place of a trial: the run folder `model`, made as long as a real one."""
    rows = (model / "metrics.jsonl").read_text().splitlines()

    def run(trial: Trial, work: Work) -> Generator[Report | None, bool | None, None]:
        began = time.process_time()
        path = folder_of(trial.key, work.folder)
        shutil.copytree(model, path, ignore=shutil.ignore_patterns("checkpoints"))
        z = trial.fidelity or 0.0
        samples = int(3.4e6 + 4.8e6 * z)
        with open(path / "metrics.jsonl", "w", encoding="utf-8") as file:
            for number in range(samples // _ITERATION):
                row = json.loads(rows[number % len(rows)])
                row |= {"iteration": number + 1, "samples": (number + 1) * _ITERATION}
                file.write(json.dumps(row) + "\n")
        off = [math.log(value) for value in trial.point.values()]
        value = 3.5 * math.exp(-sum(x * x for x in off) / 6) * (1 - 0.3 * z)
        value += 0.02 * math.sin(1e4 * sum(off))  # noise
        _spent["trials"] += time.process_time() - began
        yield Report(trial.key, "ok", value, {}, float(samples), str(path), "finished")

    return run


def measure() -> dict[str, float]:
    """Seconds of one core, by what they were for."""
    torch.set_num_threads(1)
    with tempfile.TemporaryDirectory() as place:
        model, folder = Path(place) / "model", Path(place) / "search"
        status = main(
            ["train", "experiment=morphology/walk", "budget.samples=8200", "evaluation.episodes=4",
             "evaluation.final_episodes=4", f"run.dir={model}"]
        )  # fmt: skip
        if status:
            raise SystemExit(status)
        understudy_sweeps.in_process.run_trial = replayed(model)
        CMFBO.ask = timed("asks", CMFBO.ask)
        Page._draw = timed("video", Page._draw)
        Page.write = timed("pages, with the video", Page.write)
        began, wall = time.process_time(), time.perf_counter()
        sweep(
            ["search=cmfbo/morphology", f"outer_loop.trials={TRIALS}", "outer_loop.budget=null",
             f"run.dir={folder}"]
        )  # fmt: skip
        used, passed = time.process_time() - began, time.perf_counter() - wall
    pages = _spent["pages, with the video"] - _spent["video"]
    outside = used - _spent["trials"]
    return {
        "asks": _spent["asks"],
        "pages": pages,
        "video": _spent["video"],
        "composing, journal and all else": outside - _spent["asks"] - pages - _spent["video"],
        "outside": outside,
        "passed": passed,
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--no-save", action="store_true", help="print only")
    given = parser.parse_args()
    seconds = measure()
    for name, value in seconds.items():
        print(f"{name:36s} {value:8.1f} s")
    shares = {
        k: seconds["outside"] / (seconds["outside"] + TRIALS * v) for k, v in RECORDED.items()
    }
    for name, share in shares.items():
        print(f"{100 * share:.2f} % of {TRIALS} trials of {RECORDED[name]:g} s: {name}")
    if not given.no_save:
        row = {
            "date": datetime.date.today().isoformat(),
            "trials": TRIALS,
            "parameters": 12,
            "seconds_of_one_core": {k: round(v, 2) for k, v in seconds.items()},
            "shares": {k: round(v, 4) for k, v in shares.items()},
            "cores": os.cpu_count(),
            "python": platform.python_version(),
            "torch": torch.__version__,
        }
        append(RESULTS, row)
