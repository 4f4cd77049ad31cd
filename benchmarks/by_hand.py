"""A written controller puts the arm under the hem that the other hand holds, and, from a hand in the sleeve's mouth, the arm
into its sleeve, so that the shirt's second subtask can be done and the third from there.

``python benchmarks/by_hand.py`` leads the left hand of the held start by torques, at most half of the largest, up between body
and hem and through equation 19's triangle, and with ``--task shirt_sleeve`` the left arm of the start in the sleeve out to
its side, and appends to ``docs/benchmarks/dressing_by_hand.jsonl`` in how many worlds the subtask's criterion was met, at
which decision, and the largest area ratio until then and of the whole episode.
"""

from __future__ import annotations

import argparse
import datetime
from collections.abc import Callable, Sequence
from itertools import pairwise
from pathlib import Path

import numpy as np
import torch
from rows import append
from torch import Tensor

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_dressing.moves import Moves
from understudy_dressing.shirt import ShirtScene
from understudy_dressing.waypoints import DRESSED, TUCKED_AT

RECORD = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_by_hand.jsonl"
WORDS = ("device=cpu", "simulators.person.name=mujoco", "scene.steps.cloth=10", "curriculum=null")
#: m: where the left fingertip goes, the last two places beyond the triangle.
PLACES = (*TUCKED_AT, (0.31, 0.0, -0.27), (0.31, -0.01, -0.20))
#: N m/rad and N m s/rad: of torso, spine, neck and head, then of each arm, weak enough for one torque in 40 ms.
_ARM = [(30, 2), (30, 2), (25, 2.5), (25, 2.5), (4, 0.3), (10, 0.3), (3, 0), (3, 0)]
_GAINS = [(150, 5), (150, 5), (60, 3), (5, 0), (5, 0), (5, 0), *_ARM, *_ARM]
_TORQUES = [50.0, 50.0, *20 * [12.0]]
#: Decisions from place to place; the largest share of a torque.
_ON_THE_WAY, _MOST = 14, 0.5


#: Decisions until the arm is out at its side.
_UNTIL = 60


def tucked(shirt: ShirtScene, held: np.ndarray, words: Sequence[str]) -> tuple[Tensor, ...]:
    """What `led` says of the second subtask from the held start, whose pose is `held` (22,) rad."""
    moves, way = Moves(shirt), [torch.tensor(held)]
    moves._pose = held.copy()
    for place in PLACES:
        moves.reach("left", np.array(place), 0.01, (False, False))
        way.append(torch.tensor(moves._pose))
    way.append(way[-1])
    wanted = [
        begin + _smooth((k + 1) / _ON_THE_WAY) * (end - begin)
        for begin, end in pairwise(way)
        for k in range(_ON_THE_WAY)
    ]
    return led(
        lambda k, begin: wanted[k].expand_as(begin), "shirt_tuck", "tucked", len(wanted), words
    )


def sleeved(words: Sequence[str], decisions: int = 90) -> tuple[Tensor, ...]:
    """What `led` says of the third subtask from hands in the sleeve's mouth."""

    def wanted(k: int, begin: Tensor) -> Tensor:
        end = begin.clone()
        end[:, 6:14] = torch.tensor(DRESSED)
        return begin + _smooth(min(1.0, (k + 1) / _UNTIL)) * (end - begin)

    words = ["initial_states.worn=in_sleeve", *words]
    return led(wanted, "shirt_sleeve", "dressed", decisions, words)


def _smooth(share: float) -> float:
    return share * share * (3 - 2 * share)


def led(
    wanted: Callable[[int, Tensor], Tensor], task: str, criterion: str, decisions: int, words: Sequence[str]
) -> tuple[Tensor, ...]:  # fmt: skip
    """Of each world, led to the poses (N, 22) rad that are `wanted` at each decision, given those of the start, the decision at
    which the criterion was first met, infinite where never, and the largest area ratio until then and of the whole
    episode, each (N,)."""
    environment = build_environment(
        load_experiment([f"experiment=dressing/{task}", *WORDS, *words])
    ).environment
    environment.reset(seed=3)
    table, (stiff, damp) = environment.table, torch.tensor(_GAINS).T
    torques, begin = torch.tensor(_TORQUES), environment.table["qpos"][:, :22].clone()
    met = torch.full((environment.num_worlds,), torch.inf)
    before, whole, goes_on = torch.zeros_like(met), torch.zeros_like(met), torch.ones_like(met)
    for k in range(decisions):
        q, rate = table["qpos"][:, :22], table["qvel"][:, :22]
        action = (stiff * (wanted(k, begin).float() - q) - damp * rate) / torques
        step = environment.step(action.clamp(-_MOST, _MOST))
        goes_on *= ~step.ended
        whole = torch.maximum(whole, table["area_ratio"] * goes_on)
        before = torch.where(met.isinf(), whole, before)
        now = (table[criterion] * goes_on > 0) & met.isinf()
        met = torch.where(now, float(k + 1), met)
    environment.close()
    return met, before, whole


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--edge", type=float, default=0.03)
    parser.add_argument("--task", choices=["shirt_tuck", "shirt_sleeve"], default="shirt_tuck")
    options = parser.parse_args()
    words = [f"num_worlds={options.worlds}", f"scenes.cloth.edge={options.edge}"]
    if options.task == "shirt_sleeve":
        met, before, whole = sleeved(words)
    else:
        shirt = ShirtScene(ShirtScene.Options(edge=options.edge))
        met, before, whole = tucked(shirt, shirt.settled("held", "left")[0], words)
    row = {
        "task": options.task,
        "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "edge": options.edge,
        "worlds": options.worlds, "met": int(met.isfinite().sum()), "decision": met.tolist(),
        "area_ratio_until_then": before.tolist(), "area_ratio": whole.tolist(),
    }  # fmt: skip
    print(row)
    append(RECORD, row)


if __name__ == "__main__":
    main()
