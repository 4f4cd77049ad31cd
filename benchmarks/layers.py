"""Whether self-contact has room for enough candidates where a shirt bunches: ``simulators.cloth.candidates``.

``python benchmarks/layers.py`` moves the arms in a held shirt at random, the same for each size of room, and appends to
``docs/benchmarks/cloth_layers.jsonl`` how many candidates were left out, how many vertices of other layers a vertex has
within the thickness at most, of how many vertices those are more than the room, how many pairs are nearer than half of the
thickness, the largest area ratio, and the processor time of a decision.
"""

from __future__ import annotations

import argparse
import datetime
import itertools
import time
from pathlib import Path
from typing import Any

import numpy as np
import torch
from rows import append
from scipy.spatial import KDTree

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

RECORD = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "cloth_layers.jsonl"


def layered(room: int, worlds: int, decisions: int, noise: float) -> dict[str, object]:
    words = ["experiment=dressing/shirt_tuck", "device=cpu", "simulators.person.name=mujoco",
             "scenes.cloth.edge=0.03", "scene.steps.cloth=10", "curriculum=null"]  # fmt: skip
    built = build_environment(
        load_experiment([*words, f"num_worlds={worlds}", f"simulators.cloth.candidates={room}"])
    )
    environment, drawn = built.environment, torch.Generator().manual_seed(0)
    simulator: Any = environment.parts.simulator
    cloth = simulator._members["cloth"]._cloth
    start, apart = cloth.apart_start.numpy(), cloth.apart.numpy()
    never = [set(apart[a:b]) for a, b in itertools.pairwise(start)]

    def others(x: np.ndarray, within: float) -> np.ndarray:
        """Of each vertex, how many vertices of other layers are so near."""
        near = KDTree(x).query_ball_point(x, within)
        return np.array([sum(j != i and j not in never[i] for j in js) for i, js in enumerate(near)])  # fmt: skip

    environment.reset(seed=1)
    most, over, pairs, ratio, spent = 0, 0, 0, 0.0, 0.0
    for k in range(decisions):
        action = noise * torch.randn(worlds, environment.action_size, generator=drawn)
        began = time.process_time()
        environment.step(action)
        spent += time.process_time() - began
        ratio = max(ratio, float(environment.table["area_ratio"].max()))
        if k % 3 == 2:
            for x in environment.table["cloth_position"].numpy():
                count = others(x, cloth.thickness)
                most, over = max(most, int(count.max())), over + int((count > room).sum())
                pairs += int(others(x, 0.5 * cloth.thickness).sum()) // 2
    left_out = environment.parts.simulator.report().get("cloth/candidates_left_out", 0)
    environment.close()
    return {
        "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "words": words, "room": room,
        "worlds": worlds, "decisions": decisions, "noise": noise, "left_out": left_out, "most_within_thickness": most,
        "vertices_over_room": over, "pairs_within_half": pairs, "area_ratio": round(ratio, 3),
        "cpu_ms_a_decision": round(1e3 * spent / decisions, 1),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--rooms", type=int, nargs="+", default=[8, 16, 32, 64, 128])
    parser.add_argument("--worlds", type=int, default=4)
    parser.add_argument("--decisions", type=int, default=90)
    parser.add_argument("--noise", type=float, default=0.2)
    options = parser.parse_args()
    for room in options.rooms:
        row = layered(room, options.worlds, options.decisions, options.noise)
        print(row, flush=True)
        append(RECORD, row)


if __name__ == "__main__":
    main()
