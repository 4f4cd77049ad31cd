"""A written controller puts the arm under the hem that the other hand holds, so that the shirt's second subtask can be done.

``python benchmarks/by_hand.py`` leads the left hand of the held start by torques, at most half of the largest, up between body
and hem and through equation 19's triangle, and appends to ``docs/benchmarks/dressing_by_hand.jsonl`` in how many
worlds the subtask's criterion was met, at which decision, and the largest area ratio until then and of the whole episode.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_dressing.shirt import _TUCKED_AT, Moves, ShirtScene

RECORD = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_by_hand.jsonl"
WORDS = ("device=cpu", "simulators.person.name=mujoco", "scene.steps.cloth=10", "curriculum=null")
#: m: where the left fingertip goes, the last two places beyond the triangle.
PLACES = (*_TUCKED_AT, (0.31, 0.0, -0.27), (0.31, -0.01, -0.20))
#: N m/rad and N m s/rad: of torso, spine, neck and head, then of each arm, weak enough for one torque in 40 ms.
_ARM = [(30, 2), (30, 2), (25, 2.5), (25, 2.5), (4, 0.3), (10, 0.3), (3, 0), (3, 0)]
_GAINS = [(150, 5), (150, 5), (60, 3), (5, 0), (5, 0), (5, 0), *_ARM, *_ARM]
_TORQUES = [50.0, 50.0, *20 * [12.0]]
#: Decisions from place to place; the largest share of a torque.
_ON_THE_WAY, _MOST = 14, 0.5


def tucked(shirt: ShirtScene, held: np.ndarray, words: Sequence[str]) -> tuple[Tensor, ...]:
    """Of each world the decision at which the criterion was first met, infinite where never, and the largest area ratio
    until then and of the whole episode, each (N,). `held` is the start's pose (22,) rad."""
    moves, way = Moves(shirt), [held]
    moves._pose = held.copy()
    for place in PLACES:
        moves.reach("left", np.array(place), 0.01, (False, False))
        way.append(moves._pose.copy())
    environment = build_environment(
        load_experiment(["experiment=dressing/shirt_tuck", *WORDS, *words])
    ).environment
    environment.reset(seed=3)
    table, (stiff, damp) = environment.table, torch.tensor(_GAINS).T
    torques = torch.tensor(_TORQUES)
    met = torch.full((environment.num_worlds,), torch.inf)
    before, whole, count = torch.zeros_like(met), torch.zeros_like(met), 0
    for begin, end in pairwise([*way, way[-1]]):
        for k in range(_ON_THE_WAY):
            share = (k + 1) / _ON_THE_WAY
            wanted = torch.tensor(begin + share * share * (3 - 2 * share) * (end - begin))
            q, rate = table["qpos"][:, :22], table["qvel"][:, :22]
            action = (stiff * (wanted.float() - q) - damp * rate) / torques
            environment.step(action.clamp(-_MOST, _MOST))
            count += 1
            whole = torch.maximum(whole, table["area_ratio"])
            before = torch.where(met.isinf(), whole, before)
            met = torch.where((table["tucked"] > 0) & met.isinf(), float(count), met)
    environment.close()
    return met, before, whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--edge", type=float, default=0.03)
    options = parser.parse_args()
    shirt = ShirtScene(ShirtScene.Options(edge=options.edge))
    pose, _ = shirt.settled("held", "left")
    met, before, whole = tucked(
        shirt, pose, [f"num_worlds={options.worlds}", f"scenes.cloth.edge={options.edge}"]
    )
    row = {
        "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "edge": options.edge,
        "worlds": options.worlds, "met": int(met.isfinite().sum()), "decision": met.tolist(),
        "area_ratio_until_then": before.tolist(), "area_ratio": whole.tolist(),
    }  # fmt: skip
    print(row)
    with RECORD.open("a") as file:
        file.write(json.dumps(row) + "\n")


if __name__ == "__main__":
    main()
