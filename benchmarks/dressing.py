"""Decisions per second of ``experiment=dressing/sleeve``, or another, without learning, and of its parts, in one run.

Each line is one setting: hinges in every sub-step with blocks of 512 threads, as it was, and as it is now
(``bending_every`` and ``threads`` null), and what could be changed yet. Body and cloth are also timed by
themselves; on a CPU by processor time, so that other work beside it costs nothing. Appends to ``docs/benchmarks/dressing_speed.jsonl``.

    python benchmarks/dressing.py --worlds 512 1024
    python benchmarks/dressing.py --worlds 2048 --only now --experiment dressing/shirt_sleeve --kernels 20 scenes.cloth.edge=0.03
"""

from __future__ import annotations

import argparse
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch
from rows import append

from understudy.records.runs import versions
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_speed.jsonl"
#: Decisions of which a profile is the mean.
_PROFILED = 3
#: Overrides by name.
SETTINGS = {
    "before": ("+simulators.cloth.bending_every=1", "+simulators.cloth.threads=512"),
    "threads": ("+simulators.cloth.bending_every=1",),
    "hinges": ("+simulators.cloth.threads=512",),
    "now": (),
    "now, no hinges": ("scenes.cloth.fabric={bending: 0.0}",),
    "now, no self-contact": ("+simulators.cloth.self_contact=false",),
    "now, searches every 20 sub-steps": ("+simulators.cloth.every=20",),
    "all that is felt in every control period": ("memory.extremes.reads.value=progress",),
    "now, 2 steps of the body in 10 ms": ("scene.steps.person=2",),
}


def measure(
    words: Sequence[str], worlds: int, seconds: float, kernels: int
) -> tuple[dict[str, float], list[tuple[str, float, float]]]:
    """Decisions per second of all worlds, and ms a decision of body and of cloth by themselves; and of so many
    `kernels` (on a CPU operations) that take longest the name, ms and calls a decision."""
    experiment = load_experiment([*words, f"num_worlds={worlds}"])
    built = build_environment(experiment)
    environment = built.environment
    try:
        environment.reset(seed=1)
        on_gpu = environment.device.type == "cuda"
        step = environment.captured_step if on_gpu else environment._step
        clock = time.perf_counter if on_gpu else time.process_time
        action = torch.zeros(worlds, environment.action_size, device=environment.device)

        def timed(act: Any) -> float:
            """s a call."""
            for _ in range(2):
                act()
            count, began = 0, clock()
            if on_gpu:
                torch.cuda.synchronize()
                began = clock()
            while clock() - began < seconds:
                act()
                count += 1
                if on_gpu:
                    torch.cuda.synchronize()
            return (clock() - began) / count

        def random_step() -> None:
            step(action.uniform_(-1, 1))

        whole = timed(random_step)
        simulator: Any = environment.parts.simulator
        found = {"decisions_per_second": worlds / whole, "decision_ms": 1e3 * whole}
        for name, member in simulator._members.items():
            control = simulator._control[name].clone()
            periods = environment.decision * simulator._rounds
            found[f"{name}_ms"] = 1e3 * periods * timed(lambda m=member, c=control: m.step(c))
        if not kernels:
            return found, []
        with torch.profiler.profile() as profile:
            for _ in range(_PROFILED):
                random_step()
            if on_gpu:
                torch.cuda.synchronize()
        took = [
            (one.key[:120], (one.self_device_time_total if on_gpu else one.self_cpu_time_total) / 1e3, one.count)
            for one in profile.key_averages()
        ]  # fmt: skip
        took.sort(key=lambda one: -one[1])
        return found, [(key, ms / _PROFILED, n / _PROFILED) for key, ms, n in took[:kernels]]
    finally:
        environment.close()


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--worlds", type=int, nargs="+", default=[512])
    parser.add_argument(
        "--only", nargs="+", choices=list(SETTINGS), default=list(SETTINGS), help="of the settings"
    )
    parser.add_argument("--seconds", type=float, default=5.0, help="of each measurement")
    parser.add_argument("--out", type=Path, default=RESULTS)
    parser.add_argument("--experiment", default="dressing/sleeve")
    parser.add_argument("--kernels", type=int, default=0, help="of the slowest that are named")
    parser.add_argument("more", nargs="*", help="overrides of the experiment")
    options = parser.parse_args()
    on_gpu = torch.cuda.is_available()
    for worlds in options.worlds:
        for name in options.only:
            words = [f"experiment={options.experiment}", *options.more, *SETTINGS[name]]
            found, kernels = measure(words, worlds, options.seconds, options.kernels)
            print(
                f"{worlds} worlds, {name}: {found['decisions_per_second']:.0f} decisions/s; a decision "
                + ", ".join(
                    f"{k.removesuffix('_ms')} {v:.1f} ms"
                    for k, v in found.items()
                    if k.endswith("_ms")
                ),
                flush=True,
            )
            for key, ms, calls in kernels:
                print(f"{ms:9.3f} ms {calls:8.1f} calls  {key}", flush=True)
            record = {
                "experiment": options.experiment,
                "when": time.strftime("%Y-%m-%d"),
                "device": torch.cuda.get_device_name() if on_gpu else platform.processor() or "cpu",
                "cores": os.cpu_count(),
                "worlds": worlds,
                "setting": name,
                "overrides": options.more,
                **found,
                **({"kernels": kernels} if kernels else {}),
                "versions": versions(),
            }
            append(options.out, record)


if __name__ == "__main__":
    main()
