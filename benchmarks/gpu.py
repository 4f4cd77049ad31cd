"""Speed on one GPU, as ratios measured in one run (``make bench-gpu``).

For the walk and for a contact-rich scene (the humanoid with self-collision), over world counts:
bare MuJoCo Warp steps/s; environment steps/s; collecting; learning; everything end to end; and
their ratios. Beside it, in the same run, what mjlab's environment makes of its own bare steps, where
``$UNDERSTUDY_MJLAB`` says which Python has it (``mjlab_speed.py``). Prints a table and appends it, with
the hardware, to ``docs/benchmarks/gpu.jsonl``.
"""

from __future__ import annotations

import argparse
import json
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import torch
from mjlab_speed import asked
from rows import append

from understudy.records.runs import versions
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_reinforcement.job import Reinforcement

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "gpu.jsonl"
SCENES = {"walk": (), "self_collision": ("scene.self_collision=true",)}


def seconds(step: Callable[[torch.Tensor], Any], targets: torch.Tensor) -> float:
    """How long one `step` takes."""
    torch.cuda.synchronize()
    began = time.perf_counter()
    step(targets)
    torch.cuda.synchronize()
    return time.perf_counter() - began


def rate(work: Callable[[], Any], count: int) -> float:
    """Calls of `work` per second, after one that is not counted."""
    work()
    torch.cuda.synchronize()
    began = time.perf_counter()
    for _ in range(count):
        work()
    torch.cuda.synchronize()
    return count / (time.perf_counter() - began)


def measure(scene: str, worlds: int, steps: int, overrides: list[str]) -> dict[str, Any]:
    """All rates of one scene and world count."""
    fixed = ["experiment=spacetime/walk", "simulator=mujoco_warp", f"num_worlds={worlds}"]
    training = Training(load_experiment([*fixed, *SCENES[scene], *overrides])).prepare()
    job = training.job
    assert isinstance(job, Reinforcement)
    environment, simulator = job.environment, job.environment.parts.simulator
    environment.reset(seed=0)
    for _ in range(6):  # which captures the step
        environment.step(environment.observations["feedforward"])
    if not environment.captured_step.on:
        raise SystemExit(f"{scene} × {worlds}: the step could not be captured.")
    # Each step of the environment is paired with a bare one from the same states.
    env_time = bare_time = 0.0
    for _ in range(steps):
        targets = environment.observations["feedforward"].clone()
        before = simulator.snapshot()
        bare_time += seconds(simulator.step, targets)
        simulator.restore(before)
        env_time += seconds(environment.step, targets)
    bare, stepping = worlds * steps / bare_time, worlds * steps / env_time
    environment.reset(seed=0)
    length = job.learner.rollout_steps
    collecting = rate(lambda: job.collector.collect(length), 3) * worlds * length
    rollout = job.collector.collect(length)
    learning = rate(lambda: job.learner.update(rollout), 3) * worlds * length
    everything = rate(training.iterate, 3) * worlds * length
    if int(environment.quarantined) or "contact_or_constraint_overflows" in simulator.report():
        raise SystemExit(f"{scene} × {worlds}: numbers left the finite or contacts were dropped.")
    free, total = torch.cuda.mem_get_info()
    training.close()
    return {
        "scene": scene,
        "worlds": worlds,
        "bare_physics_steps_per_second": bare * job.substeps,
        "environment_steps_per_second": stepping,
        "collected_samples_per_second": collecting,
        "learned_samples_per_second": learning,
        "samples_per_second": everything,
        "environment_to_bare": stepping / bare,
        "collecting_to_bare": collecting / bare,
        "end_to_end_to_collecting": everything / collecting,
        "gpu_memory_gib": (total - free) / 2**30,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--worlds", type=int, nargs="+", default=[1024, 4096, 16384])
    parser.add_argument("--scenes", nargs="+", choices=sorted(SCENES), default=sorted(SCENES))
    parser.add_argument("--steps", type=int, default=48)
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("overrides", nargs="*", help="Hydra overrides of experiment=spacetime/walk")
    options = parser.parse_args()
    rows = []
    for scene in options.scenes:
        for worlds in options.worlds:
            row = measure(scene, worlds, options.steps, options.overrides)
            rows.append(row)
            torch.cuda.empty_cache()
            print(
                json.dumps({k: round(v, 3) if isinstance(v, float) else v for k, v in row.items()}),
                flush=True,
            )
    peer = asked(options.worlds)
    print(peer if isinstance(peer, str) else "\n".join(map(json.dumps, peer)), flush=True)
    record = {
        "when": time.strftime("%Y-%m-%d"),
        "gpu": torch.cuda.get_device_name(),
        "versions": versions(),
        "rows": rows,
        "peer": peer,
    }
    append(options.out, record)


if __name__ == "__main__":
    main()
