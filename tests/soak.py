"""A long training of the walk, watched from beside it: does anything grow, does anything slow down?

Prints, and writes as JSON with ``--out``, for the memory, threads and descriptors of the process and the
samples a second by its CPU clock and by the wall's: the mean, and by how much of it the straight line
through all measurements rises over them. The first quarter warms up and is not counted. Ends with 1 if
something but the wall clock's speed, which is also that of what else the machine does, is beyond 5 %::

    python tests/soak.py --minutes 60
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import threading
import time
from pathlib import Path

import numpy as np

from understudy.records import runs
from understudy.running.training import Training
from understudy.setup.composition import load_experiment

LIMIT = 0.05
#: An evaluation every so many samples, so that what it keeps is watched, too.
OVERRIDES = (
    "experiment=spacetime/walk", "num_worlds=64", "simulator.threads=1", "evaluation.criterion=null",
    "evaluation.every_samples=40000", "evaluation.episodes=16", "evaluation.gate=0",
    "evaluation.seconds=2", "checkpoint.minutes=0.1", "budget.samples=null",
)  # fmt: skip


def measured(row: dict[str, float], before: tuple[float, float, float]) -> dict[str, float]:
    """What the process holds, and how fast it was since `before` (samples, CPU and wall seconds)."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    samples, cpu, wall = row["samples"] - before[0], time.process_time(), time.monotonic()
    return {
        "seconds": wall,
        "memory_mb": int(status["VmRSS"].split()[0]) / 1024,
        "threads": threading.active_count() + int(status["Threads"]),
        "descriptors": len(os.listdir("/proc/self/fd")),
        "samples_per_cpu_second": samples / (cpu - before[1]),
        "samples_per_second": samples / (wall - before[2]),
    }


def soak(minutes: float, overrides: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """By what was watched: ``mean``, ``rise`` as a share of it, and ``rise_per_hour``."""
    with tempfile.TemporaryDirectory() as folder:
        overrides = (*OVERRIDES, f"budget.minutes={minutes}", f"run.dir={folder}/run", *overrides)
        experiment = load_experiment(overrides)
        training = Training(experiment).prepare()
        training.attach(runs.create(experiment, overrides, training.job.sources()))
        table: list[dict[str, float]] = []
        before = (0.0, time.process_time(), time.monotonic())
        for row in training.rows():
            table.append(measured(row, before))
            before = (row["samples"], time.process_time(), time.monotonic())
        training.close()
    counted = table[len(table) // 4 :]
    seconds = np.array([row.pop("seconds") for row in counted])
    found = {}
    for name in counted[0]:
        values = np.array([row[name] for row in counted])
        slope, _ = np.polyfit(seconds, values, 1)
        rise = slope * (seconds[-1] - seconds[0])
        found[name] = {
            "mean": float(values.mean()),
            "rise": float(rise / values.mean()),
            "rise_per_hour": float(slope * 3600),
        }
    return found


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--out", type=Path)
    options, overrides = parser.parse_known_args()
    found = soak(options.minutes, tuple(overrides))
    print(f"{options.minutes:g} minutes, the first quarter not counted")
    for name, figures in found.items():
        print(
            f"{name:24} {figures['mean']:10.1f}   rises by {figures['rise']:+8.2%}   "
            f"{figures['rise_per_hour']:+10.2f} an hour"
        )
    if options.out:
        options.out.write_text(json.dumps({"minutes": options.minutes, **found}, indent=1) + "\n")
    judged = {name: f for name, f in found.items() if name != "samples_per_second"}
    worse = [
        name
        for name, f in judged.items()
        if (f["rise"] < -LIMIT if name.startswith("samples") else f["rise"] > LIMIT)
    ]
    print(f"Beyond 5 %: {', '.join(worse)}." if worse else "All within 5 %.")
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main())
