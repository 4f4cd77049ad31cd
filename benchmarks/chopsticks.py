"""Control steps per second of ``chopsticks/open_close_gpu`` beside bare MuJoCo Warp, in one run.

Both take the same model from the same states under the same targets. Bare is a control period of ``mujoco_warp.step``
and nothing else, as one CUDA graph; the environment's step is the whole task: plan, state, rewards, endings,
beginnings. Then collecting, and everything with learning. Appends a line to ``docs/benchmarks/chopsticks.jsonl``.

    python benchmarks/chopsticks.py --worlds 4096 8192
    python benchmarks/chopsticks.py --device cpu --worlds 4 --steps 4 --out /tmp/try.jsonl     # does it run?
"""

from __future__ import annotations

import argparse
import json
import platform
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import mujoco_warp as mjw
import torch
import warp as wp
from rows import append

from understudy.records.runs import versions
from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy_mujoco_warp.simulator import MujocoWarpSimulator
from understudy_reinforcement.job import Reinforcement

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "chopsticks.jsonl"


def wait() -> None:
    if torch.cuda.is_available():
        torch.cuda.synchronize()
    wp.synchronize()


def seconds(work: Callable[[], Any], count: int = 1) -> float:
    """Of so many calls."""
    wait()
    began = time.perf_counter()
    for _ in range(count):
        work()
    wait()
    return time.perf_counter() - began


class Bare:
    """The simulator's model in worlds of its own."""

    def __init__(self, simulator: MujocoWarpSimulator, worlds: int, substeps: int) -> None:
        own = simulator._d
        self._substeps, self._of = substeps, own
        with wp.ScopedDevice(own.qpos.device):
            self._m = mjw.put_model(simulator.model)
            self._m.opt.warn_overflow = 0
            self._d = mjw.make_data(
                simulator.model, nworld=worlds, nconmax=own.naconmax // worlds, njmax=own.njmax
            )
            self._work()  # compiles
            self._graph = None
            if own.qpos.device.is_cuda:
                with wp.ScopedCapture() as capture:
                    self._work()
                self._graph = capture.graph

    def _work(self) -> None:
        for _ in range(self._substeps):
            mjw.step(self._m, self._d)

    def take(self) -> None:
        """The simulator's states, and the controls that it was given last."""
        for name in ("qpos", "qvel", "ctrl", "qacc_warmstart"):
            wp.copy(getattr(self._d, name), getattr(self._of, name))

    def step(self) -> None:
        if self._graph is None:
            self._work()
        else:
            wp.capture_launch(self._graph)


def measure(worlds: int, steps: int, device: str, overrides: list[str]) -> dict[str, Any]:
    words = ["experiment=chopsticks/open_close_gpu", f"num_worlds={worlds}", f"device={device}"]
    training = Training(load_experiment([*words, *overrides])).prepare()
    job = training.job
    assert isinstance(job, Reinforcement)
    environment, simulator = job.environment, job.environment.parts.simulator
    assert isinstance(simulator, MujocoWarpSimulator)
    bare = Bare(simulator, worlds, job.substeps)
    environment.reset(seed=0)
    action = torch.zeros(worlds, environment.action_size, device=environment.device)
    for _ in range(6):  # which captures the step
        environment.step(action)
    if environment.device.type == "cuda" and not environment.captured_step.on:
        raise SystemExit("The step could not be captured.")
    env_time = bare_time = 0.0
    for _ in range(steps):
        noise = 0.1 * torch.randn_like(action)
        bare.take()
        bare_time += seconds(bare.step)
        env_time += seconds(lambda noise=noise: environment.step(noise))
    length = job.learner.rollout_steps
    environment.reset(seed=0)
    job.collector.collect(length)
    repeats = 3 if environment.device.type == "cuda" else 1
    collecting = seconds(lambda: job.collector.collect(length), repeats) / repeats
    training.iterate()
    everything = seconds(training.iterate, repeats) / repeats
    report = simulator.report()
    if int(environment.quarantined) or "contact_or_constraint_overflows" in report:
        raise SystemExit(f"Numbers left the finite or contacts were dropped: {report}.")
    training.close()
    return {
        "worlds": worlds,
        "bare_control_steps_per_second": worlds * steps / bare_time,
        "environment_steps_per_second": worlds * steps / env_time,
        "environment_to_bare": bare_time / env_time,
        "collected_samples_per_second": worlds * length / collecting,
        "samples_per_second": worlds * length / everything,
        "at_limits": report,
    }


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--worlds", type=int, nargs="+", default=[4096, 8192])
    parser.add_argument("--steps", type=int, default=100)
    parser.add_argument("--device", default="cuda")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("overrides", nargs="*", help="of experiment=chopsticks/open_close_gpu")
    options = parser.parse_args()
    rows = []
    for worlds in options.worlds:
        rows.append(measure(worlds, options.steps, options.device, options.overrides))
        print(json.dumps(rows[-1]), flush=True)
    cuda = options.device != "cpu"
    record = {
        "when": time.strftime("%Y-%m-%d"),
        "device": torch.cuda.get_device_name() if cuda else platform.processor(),
        "versions": versions(),
        "overrides": options.overrides,
        "rows": rows,
    }
    append(options.out, record)


if __name__ == "__main__":
    main()
