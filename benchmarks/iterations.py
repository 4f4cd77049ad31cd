"""Where the time of an iteration goes on a GPU: collecting, learning, and the kernels of both.

``python benchmarks/iterations.py NAME experiment=… [KEY=VALUE …]`` trains a few iterations and then times some more by the
device's own clock; ``--kernels 15`` prints those that took the most. A JSON line is appended to ``docs/benchmarks/iterations.jsonl``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from torch.profiler import ProfilerActivity, profile

from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_reinforcement.job import Reinforcement

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "iterations.jsonl"
#: Until all graphs are captured; and those that count.
BEFORE, COUNTED = 6, 6


def timed(work: Callable[[Any], Any], found: list[tuple[Any, Any]]) -> Callable[[Any], Any]:
    """`work`, of which each call leaves an event before it and one after it in `found`."""

    def call(given: Any) -> Any:
        events = [torch.cuda.Event(enable_timing=True) for _ in range(2)]
        events[0].record()
        result = work(given)
        events[1].record()
        found.append((events[0], events[1]))
        return result

    return call


def kernels(what: str, work: Callable[[], Any], most: int) -> Any:
    """Print the `most` kernels of `work` that take the longest; returns what it does."""
    torch.cuda.synchronize()
    with profile(activities=[ProfilerActivity.CUDA]) as seen:
        result = work()
        torch.cuda.synchronize()
    rows = sorted(seen.key_averages(), key=lambda row: -row.self_device_time_total)
    busy, count = sum(row.self_device_time_total for row in rows), sum(row.count for row in rows)
    print(f"{what}: {1e-3 * busy:.1f} ms in {count} kernels")
    for row in rows[:most]:
        print(f"  {1e-3 * row.self_device_time_total:8.2f} ms {row.count:6d}  {row.key[:100]}")
    return result


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("name", help="of the line")
    parser.add_argument("overrides", nargs="+", help="of the experiment")
    parser.add_argument("--kernels", type=int, default=0, help="print so many of each half")
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    training = Training(load_experiment(given.overrides)).prepare()
    job = training.job
    assert isinstance(job, Reinforcement)
    collect, update = job.collector.collect, job.learner.update
    metrics = [training.iterate() for _ in range(BEFORE)][-1]
    spans: dict[str, list[tuple[Any, Any]]] = {"collect": [], "update": []}
    job.collector.collect = timed(collect, spans["collect"])  # type: ignore[method-assign]
    job.learner.update = timed(update, spans["update"])  # type: ignore[method-assign]
    torch.cuda.synchronize()
    began = time.perf_counter()
    for _ in range(COUNTED):
        training.iterate()
    torch.cuda.synchronize()
    wall = (time.perf_counter() - began) / COUNTED
    samples = job.environment.num_worlds * job.learner.rollout_steps
    row = {
        "when": time.strftime("%Y-%m-%d"),
        "case": given.name,
        "card": torch.cuda.get_device_name(),
        "physics_hz": metrics["physics_hz"],
        "worlds": job.environment.num_worlds,
        "samples": samples,
        "wall_ms": round(1e3 * wall, 2),
        "gpu_ms": {k: round(sum(a.elapsed_time(b) for a, b in v) / COUNTED, 2) for k, v in spans.items()},
        "k_samples_s": round(1e-3 * samples / wall, 1),
    }  # fmt: skip
    print(line := json.dumps(row))
    with open(given.out, "a", encoding="utf-8") as file:
        file.write(line + "\n")
    if given.kernels:
        steps = job.learner.rollout_steps
        rollout = kernels("collecting", lambda: collect(steps), given.kernels)
        kernels("learning", lambda: update(rollout), given.kernels)
    training.close()


if __name__ == "__main__":
    main()
