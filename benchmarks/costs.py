"""What a decision of the walk costs in each variant of `ablation=spacetime/costs`, and with all pairs of geoms looked at.

All are built in one process and stepped in turns, so that what else a machine does meets all of them. On a CPU the figures are
its processor's time, on a GPU the clock's. A line of JSON each, of the physics that a training begins with and of the fine one;
they are appended to ``docs/benchmarks/costs.jsonl``. What a variant is worth is what the ablation says.
"""

from __future__ import annotations

import argparse
import json
import os
import time
from pathlib import Path
from typing import Any

import torch

import understudy_mujoco.simulator as plain
from understudy.running.environment import Environment
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import compose_raw, load_experiment
from understudy_reinforcement.resolution import resolution_of

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "costs.jsonl"


def variants() -> dict[str, list[str]]:
    """Of the ablation, by name; and that of pairs."""
    found = compose_raw(["ablation=spacetime/costs"])["outer_loop"]["variants"]
    return {name: list(words) for name, words in found.items()} | {"all_pairs": []}


def built(name: str, words: list[str], coarse: bool, given: argparse.Namespace) -> Built:
    """A variant at its coarse or fine physics."""
    experiment = load_experiment(["experiment=spacetime/walk", *given.overrides, *words])
    coarsest = resolution_of(experiment).substeps if coarse else None
    lean = plain.lean
    if name == "all_pairs":  # MuJoCo finds for itself what may touch
        plain.lean = lambda spec: spec.compile()
    try:
        whole = build_environment(experiment, substeps=coarsest)
    finally:
        plain.lean = lean
    environment = whole.environment
    environment.reset(seed=0)
    for _ in range(6):  # on a GPU the step is captured
        environment.step(environment.observations["feedforward"])
    return whole


def seconds(environment: Environment, steps: int) -> float:
    """What so many decisions take."""
    cuda = torch.cuda.is_available()
    clock = time.perf_counter if cuda else time.process_time
    if cuda:
        torch.cuda.synchronize()
    began = clock()
    for _ in range(steps):
        environment.step(environment.observations["feedforward"])
    if cuda:
        torch.cuda.synchronize()
    return clock() - began


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--steps", type=int, default=8, help="decisions in a turn")
    parser.add_argument("--turns", type=int, default=8, help="of each variant")
    parser.add_argument("--out", type=Path, default=RESULTS, help="where records are appended")
    parser.add_argument("overrides", nargs="*", help="Hydra overrides of all variants")
    given = parser.parse_args()
    cuda = torch.cuda.is_available()
    named = variants()
    if cuda:
        del named["all_pairs"]  # which `simulator=mujoco` alone leaves out
    found = [
        (name, coarse, built(name, words, coarse, given), [])
        for name, words in named.items()
        for coarse in (True, False)
    ]
    for _ in range(given.turns):
        for _, _, whole, taken in found:
            taken.append(seconds(whole.environment, given.steps))
    # The least of the turns: what else the machine does only ever adds.
    each = {(n, c): min(taken) / given.steps / w.context.num_worlds for n, c, w, taken in found}
    about: dict[str, Any] = {
        "when": time.strftime("%Y-%m-%d"),
        "machine": torch.cuda.get_device_name() if cuda else f"CPU, {os.cpu_count()} cores",
        "of": "the clock" if cuda else "processor time",
    }
    with open(given.out, "a", encoding="utf-8") as file:
        for name, coarse, whole, _ in found:
            context = whole.context
            row = about | {
                "variant": name,
                "worlds": context.num_worlds,
                "physics_hz": round(context.substeps / context.control_dt),
                "decisions_hz": round(1.0 / context.control_dt),
                "decision_us": round(1e6 * each[name, coarse], 2),
                "to_full": round(each[name, coarse] / each["full", coarse], 3),
            }
            print(line := json.dumps(row), flush=True)
            file.write(line + "\n")


if __name__ == "__main__":
    main()
