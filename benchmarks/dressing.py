"""Decisions per second of ``experiment=dressing/sleeve`` without learning, and of its parts, in one run.

Each line is one setting: hinges in every sub-step with blocks of 512 threads, as it was, and as it is now
(``bending_every`` and ``threads`` null), and what could be changed yet. Body and cloth are also timed by
themselves; on a CPU by processor time, so that other work beside it costs nothing. Appends to ``docs/benchmarks/dressing_speed.jsonl``.

    python benchmarks/dressing.py --worlds 512 1024
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import torch

from understudy.records.runs import versions
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_speed.jsonl"
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
    worlds: int, settings: Sequence[str], seconds: float, more: Sequence[str]
) -> dict[str, float]:
    """Decisions per second of all worlds, and s a decision of body and of cloth by themselves."""
    experiment = load_experiment(
        ["experiment=dressing/sleeve", f"num_worlds={worlds}", *more, *settings]
    )
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
        return found
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
    parser.add_argument("more", nargs="*", help="overrides of the experiment")
    options = parser.parse_args()
    on_gpu = torch.cuda.is_available()
    for worlds in options.worlds:
        for name in options.only:
            settings = SETTINGS[name]
            found = measure(worlds, settings, options.seconds, options.more)
            print(
                f"{worlds} worlds, {name}: {found['decisions_per_second']:.0f} decisions/s; a decision "
                + ", ".join(
                    f"{k.removesuffix('_ms')} {v:.1f} ms"
                    for k, v in found.items()
                    if k.endswith("_ms")
                ),
                flush=True,
            )
            record = {
                "when": time.strftime("%Y-%m-%d"),
                "device": torch.cuda.get_device_name() if on_gpu else platform.processor() or "cpu",
                "cores": os.cpu_count(),
                "worlds": worlds,
                "setting": name,
                "overrides": options.more,
                **found,
                "versions": versions(),
            }
            options.out.parent.mkdir(parents=True, exist_ok=True)
            with open(options.out, "a", encoding="utf-8") as file:
                file.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
