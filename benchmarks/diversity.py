"""Diversity searches on landscapes of strategies that are known: how many they find at equal cost.

``python benchmarks/diversity.py --seeds 20`` runs Bayesian diversity search, random search and MAP-Elites
through ``OuterLoop.ask`` and ``tell``, prints a table and appends a line per landscape to
``docs/benchmarks/diversity.jsonl``. ``--ask`` times an ask after 60 trials of 4 parameters instead.

A landscape divides the unit cube among K strategies, each with a feature of its own, an angle in [0, π], to
which noise is added. Of steps, the feature rises with a smooth function of the point as orientations do
with the angular velocity at take-off: much of the cube is one flat region or another, and the strategies at
both ends are rare. Of patches, nothing is to be learned from neighbours: regions lie in any order.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
import platform
import statistics
import time
from collections.abc import Callable
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rows import append
from scipy import stats

from understudy.options import make_options
from understudy_diversity.map_elites import MapElites
from understudy_diversity.search import DiversitySearch, RandomDiversity
from understudy_sweeps.loops import OuterLoop, Report, Trial

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "diversity.jsonl"
NOISE = 0.03  #: rad


@dataclass(frozen=True)
class Landscape:
    """K strategies in d dimensions; n trials. Where s(x) is in the share `failing` at its low end, nothing
    succeeds."""

    kind: str
    d: int
    k: int
    n: int
    failing: float = 0.0


#: The first two have the sizes of the searches of section 4.7.
LANDSCAPES = {
    "steps, 4 dimensions, 10 trials": Landscape("steps", 4, 8, 10),
    "steps, 3 dimensions, 17 trials": Landscape("steps", 3, 8, 17),
    "steps, 3 dimensions, 17 trials, some fail": Landscape("steps", 3, 8, 17, 0.25),
    "patches, 4 dimensions, 10 trials": Landscape("patches", 4, 8, 10),
    "patches, 3 dimensions, 17 trials": Landscape("patches", 3, 8, 17),
}
LOOPS: dict[str, Any] = {
    "bayesian": DiversitySearch,
    "random": RandomDiversity,
    "map_elites": MapElites,
}


class World:
    """One landscape, drawn from `seed`: x (d,) → which strategy, and its feature."""

    def __init__(self, landscape: Landscape, seed: int) -> None:
        rng, d, k = np.random.default_rng(seed), landscape.d, landscape.k
        self.landscape = landscape
        if landscape.kind == "steps":
            ridges = rng.normal(size=(4, d)), rng.uniform(size=(4, d)), rng.normal(size=4)
            self._ridges = ridges
            values = self._smooth(rng.uniform(size=(50_000, d)))
            self._low, self._high = values.min(), values.max()
            self._fails = np.quantile(values, landscape.failing)
        else:
            self._centres = rng.uniform(size=(k, d))
            self._sizes = rng.lognormal(0.0, 0.5, size=k)
        order = np.arange(k) if landscape.kind == "steps" else rng.permutation(k)
        self.features = np.pi * (order + 0.5) / k
        self.noise = np.random.default_rng(seed + 1_000_000)

    def _smooth(self, x: np.ndarray) -> np.ndarray:
        directions, centres, weights = self._ridges
        along = 3.0 * ((x[:, None] - centres) * directions).sum(-1)
        return (np.tanh(along) * weights).sum(-1)

    def kind(self, x: np.ndarray) -> int:
        """The number of the strategy, or -1."""
        if self.landscape.kind == "patches":
            return int((np.linalg.norm(self._centres - x, axis=1) / self._sizes).argmin())
        value = float(self._smooth(x[None])[0])
        if value < self._fails and self.landscape.failing:
            return -1
        share = (value - self._low) / (self._high - self._low)
        return int(np.clip(share * self.landscape.k, 0, self.landscape.k - 1))

    def report(self, trial: Trial) -> Report:
        kind = self.kind(np.array(list(trial.point.values())))
        angle = self.features[kind] + self.noise.normal(0.0, NOISE) if kind >= 0 else 0.0
        measures = {"angle": float(angle), "success_rate": float(kind >= 0)}
        return Report(trial.key, "ok", measures["success_rate"], measures, 1.0)


def make(name: str, landscape: Landscape, seed: int) -> OuterLoop:
    options = {
        "parameters": {f"a.x{i}": {"low": 0.0, "high": 1.0} for i in range(landscape.d)},
        "features": {"angle": {"low": 0.0, "high": math.pi}},
        "distinct": 0.5 * math.pi / landscape.k,
        "trials": landscape.n,
    }
    return LOOPS[name](make_options(LOOPS[name].Options, options, "outer_loop"), seed)


def count(name: str, landscape: Landscape, seed: int) -> int:
    """How many different strategies the search `name` finds."""
    torch.set_num_threads(1)
    world, loop = World(landscape, seed), make(name, landscape, seed)
    found, number = set(), 0
    while (trial := loop.ask(number)) is not None:
        number += 1
        found.add(world.kind(np.array(list(trial.point.values()))))
        loop.tell(world.report(trial))
    return len(found - {-1})


def mean_interval(values: list[float]) -> tuple[float, float, float]:
    """Mean and its 95 % interval, Student's t."""
    mean = statistics.fmean(values)
    reach = stats.t.ppf(0.975, len(values) - 1) * statistics.stdev(values) / math.sqrt(len(values))
    return mean, mean - reach, mean + reach


def compare(seeds: int, run: Callable[..., Any]) -> None:
    for title, landscape in LANDSCAPES.items():
        jobs = [(name, landscape, seed) for name in LOOPS for seed in range(seeds)]
        counts = list(run(count, *zip(*jobs, strict=True)))
        found = {name: counts[i * seeds : (i + 1) * seeds] for i, name in enumerate(LOOPS)}
        row: dict[str, Any] = {"landscape": title, "strategies": landscape.k, "seeds": seeds}
        for name, values in found.items():
            more = [a - b for a, b in zip(values, found["random"], strict=True)]
            row[name] = {"found": mean_interval(values)}
            if name != "random":
                row[name]["more_than_random"] = mean_interval(more)
        row |= {"date": datetime.date.today().isoformat(), "python": platform.python_version()}
        print(json.dumps(row))
        append(RESULTS, row)


def time_ask() -> None:
    landscape = Landscape("steps", 4, 8, 200)
    for name in LOOPS:
        world, loop, slowest = World(landscape, 0), make(name, landscape, 0), 0.0
        for number in range(60):
            began = time.perf_counter()
            trial = loop.ask(number)
            slowest = max(slowest, time.perf_counter() - began)
            assert trial is not None
            loop.tell(world.report(trial))
        print(f"{name}: the slowest of 60 asks took {slowest:.2f} s")


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", type=int, default=20)
    parser.add_argument("--jobs", type=int, default=1)
    parser.add_argument("--ask", action="store_true")
    arguments = parser.parse_args()
    torch.set_num_threads(1)
    if arguments.ask:
        time_ask()
        return
    with ProcessPoolExecutor(arguments.jobs, get_context("forkserver")) as pool:
        compare(arguments.seeds, pool.map)


if __name__ == "__main__":
    main()
