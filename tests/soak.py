"""A long training of the walk, watched from beside it: does anything grow, does anything slow down?

For the memory, threads and descriptors of the process, and for its speed, it prints the mean and by how
much of it the straight line through all measurements rises or falls over them. The first quarter warms up
and is not counted. Speed is samples a second of processor time (user and system, of all threads) and of the
wall's clock. What else a machine does slows the latter and, by caches and cores that are shared, the former:
a fixed piece of like work (physics and networks), timed after each iteration, says by how much, and speed is
given against it, too.
Ends with 1 if memory, threads, descriptors or the speed against the fixed work change by more than 5 %, in
either direction, or if samples a second of processor time fall by more. ``--out`` appends the figures, with
the hardware, as a line of JSON::

    OMP_NUM_THREADS=1 nice -n 5 python tests/soak.py --minutes 60 --out docs/benchmarks/soak.jsonl
"""

from __future__ import annotations

import argparse
import json
import os
import sys
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import understudy_mujoco  # isort: skip  # noqa: F401 - before torch, to tell its threads how to wait
import mujoco
import numpy as np
import torch

from understudy.records import runs
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_mujoco.simulator import MujocoSimulator
from understudy_reinforcement.job import Reinforcement

LIMIT = 0.05
#: What may not change, and what may not fall: it rises when the machine has less else to do.
STEADY = ("memory_mb", "threads", "descriptors", "samples_per_fixed_work")
NOT_FALLING = ("samples_per_cpu_second",)
#: Measurements of a soak, less in a short one: of an hour's, each covers evaluations and checkpoints.
WINDOWS = 80
#: An evaluation every so many samples, so that what it keeps is watched, too.
OVERRIDES = (
    "experiment=spacetime/walk", "num_worlds=64", "simulator.threads=1", "evaluation.criterion=null",
    "evaluation.every_samples=40000", "evaluation.episodes=16", "evaluation.gate=0",
    "evaluation.seconds=2", "checkpoint.minutes=0.1", "budget.samples=null",
)  # fmt: skip


def clocks() -> np.ndarray:
    return np.array([time.process_time(), time.monotonic()])


class FixedWork:
    """Physics, matrix products and small operations like a training's, the same each time."""

    def __init__(self, model: mujoco.MjModel) -> None:
        self._model = model
        self._worlds = [mujoco.MjData(model) for _ in range(16)]
        self._weights = torch.ones(256, 256) / 256

    def __call__(self) -> float:
        """Processor seconds that it took."""
        began = time.process_time()
        for world in self._worlds:
            mujoco.mj_resetData(self._model, world)
            mujoco.mj_step(self._model, world, nstep=55)
        for _ in range(40):
            value = torch.ones(64, 256)
            for _ in range(4):
                value = torch.relu(value @ self._weights + 0.5 * value)
        return time.process_time() - began


def held() -> dict[str, float]:
    """What the process holds now."""
    status = dict(line.split(":", 1) for line in Path("/proc/self/status").read_text().splitlines())
    return {
        "memory_mb": int(status["VmRSS"].split()[0]) / 1024,
        "threads": int(status["Threads"]),
        "descriptors": len(os.listdir("/proc/self/fd")),
    }


def processor() -> str:
    lines = Path("/proc/cpuinfo").read_text().splitlines()
    return next((x.partition(": ")[2] for x in lines if x.startswith("model name")), "unknown")


def line_through(seconds: np.ndarray, values: np.ndarray) -> dict[str, float]:
    """``mean``, ``rise`` over all of `seconds` as a share of it, and ``rise_per_hour``."""
    slope, _ = np.polyfit(seconds, values, 1)
    rise = slope * (seconds[-1] - seconds[0]) / values.mean()
    return {
        "mean": float(values.mean()), "rise": float(rise), "rise_per_hour": float(slope * 3600),
    }  # fmt: skip


def soak(minutes: float, overrides: tuple[str, ...]) -> dict[str, dict[str, float]]:
    """What `line_through` says, by what was watched."""
    table: list[dict[str, float]] = []
    with tempfile.TemporaryDirectory() as folder:
        overrides = (*OVERRIDES, f"budget.minutes={minutes}", f"run.dir={folder}/run", *overrides)
        experiment = load_experiment(overrides)
        training = Training(experiment).prepare()
        training.attach(runs.create(experiment, overrides, training.job.sources()))
        job = training.job
        assert isinstance(job, Reinforcement)
        simulator = job.environment.parts.simulator
        assert isinstance(simulator, MujocoSimulator)
        fixed_work = FixedWork(simulator.model)
        samples, before, fixed = 0.0, clocks(), []
        for row in training.rows():
            fixed.append(fixed_work())
            processor, wall = clocks() - before
            if wall >= minutes * 60 / WINDOWS:
                per_cpu_second = (row["samples"] - samples) / (processor - sum(fixed))
                table.append(
                    {
                        "seconds": time.monotonic(),
                        **held(),
                        "samples_per_cpu_second": per_cpu_second,
                        "samples_per_second": (row["samples"] - samples) / wall,
                        "fixed_works_per_cpu_second": len(fixed) / sum(fixed),
                        "samples_per_fixed_work": per_cpu_second * sum(fixed) / len(fixed),
                    }
                )
                samples, before, fixed = row["samples"], clocks(), []
        training.close()
    counted = table[len(table) // 4 :]
    columns = {name: np.array([row[name] for row in counted]) for name in counted[0]}
    seconds = columns.pop("seconds")
    return {name: line_through(seconds, values) for name, values in columns.items()}


def beyond(found: Mapping[str, Mapping[str, float]]) -> list[str]:
    """What is not as it must be."""
    rises = {name: figures["rise"] for name, figures in found.items()}
    changed = [name for name in STEADY if abs(rises[name]) > LIMIT]
    return changed + [name for name in NOT_FALLING if rises[name] < -LIMIT]


def main() -> int:
    parser = argparse.ArgumentParser(description="Does anything grow or slow down?")
    parser.add_argument("--minutes", type=float, default=60.0)
    parser.add_argument("--out", type=Path)
    options, overrides = parser.parse_known_args()
    found = soak(options.minutes, tuple(overrides))
    print(f"{options.minutes:g} minutes, the first quarter not counted")
    for name, figures in found.items():
        print(
            f"{name:26} {figures['mean']:10.1f}   rises by {figures['rise']:+8.2%}   "
            f"{figures['rise_per_hour']:+10.2f} an hour"
            + ("" if name in STEADY + NOT_FALLING else "   (not judged)")
        )
    if options.out:
        machine = {
            "when": time.strftime("%Y-%m-%d"), "processor": processor(),
            "cores": os.cpu_count(), "torch_threads": torch.get_num_threads(),
            "versions": runs.versions(), "minutes": options.minutes, "watched": found,
        }  # fmt: skip
        with options.out.open("a") as file:
            file.write(json.dumps(machine) + "\n")
    worse = beyond(found)
    print(f"Beyond 5 %: {', '.join(worse)}." if worse else "All within 5 %.")
    return int(bool(worse))


if __name__ == "__main__":
    sys.exit(main())
