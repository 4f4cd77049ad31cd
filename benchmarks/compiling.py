"""How long Warp's kernels take to compile: the walk on `simulator=mujoco_warp` up to its first iteration.

In fresh processes, each with an empty cache of kernels: one module after the other when it is first
launched, as Warp does it, and side by side, as `Kernels` does it; then once more with that cache, which is filled.
Prints a line for each and appends them to `docs/benchmarks/compiling.jsonl`.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from typing import Any

import torch
from rows import append

import understudy_warp_torch.kernels as kernels
from understudy.records.runs import versions
from understudy.running.training import Training
from understudy.setup.composition import load_experiment

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "compiling.jsonl"


def measure(side_by_side: bool, overrides: list[str]) -> dict[str, Any]:
    """Seconds of the clock and of processors until the first iteration is done, in this process."""
    if not side_by_side:
        kernels.compile_kernels = lambda work, device: None
    experiment = load_experiment(["experiment=spacetime/walk", "simulator=mujoco_warp", *overrides])
    began, before = time.perf_counter(), time.process_time()
    training = Training(experiment).prepare()
    built = time.perf_counter() - began
    training.iterate()
    return {
        "side_by_side": side_by_side,
        "built_seconds": round(built, 2),
        "first_iteration_seconds": round(time.perf_counter() - began, 2),
        "processor_seconds": round(time.process_time() - before, 2),
    }


def alone(side_by_side: bool, cache: str, overrides: list[str]) -> dict[str, Any]:
    """`measure` in a process of its own, with the kernels of `cache`."""
    command = [sys.executable, __file__, "--alone", "together" if side_by_side else "in-turn"]
    environment = {**os.environ, "WARP_CACHE_PATH": cache}
    done = subprocess.run(
        [*command, *overrides], env=environment, stdout=subprocess.PIPE, text=True, check=True
    )
    return json.loads(done.stdout.splitlines()[-1])


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--alone", choices=["in-turn", "together"], help=argparse.SUPPRESS)
    parser.add_argument("--out", type=Path, default=RESULTS, help="where records are appended")
    parser.add_argument("overrides", nargs="*", help="Hydra overrides of the walk")
    options = parser.parse_args()
    if options.alone:
        print(json.dumps(measure(options.alone == "together", options.overrides)))
        return
    cuda = torch.cuda.is_available()
    about = {
        "when": time.strftime("%Y-%m-%d"),
        "machine": torch.cuda.get_device_name() if cuda else "CPU",
        "processors": os.cpu_count(),
        "versions": versions(),
    }
    for side_by_side, states in ((False, ("empty",)), (True, ("empty", "filled"))):
        with tempfile.TemporaryDirectory() as cache:
            for state in states:
                row = {"cache": state, **alone(side_by_side, cache, options.overrides)}
                print(json.dumps(row), flush=True)
                append(options.out, {**about, **row})


if __name__ == "__main__":
    main()
