"""Follows by torques the ways along which arms were led into the shirt's sleeve, so that the third subtask can be done.

``python benchmarks/dressing_way.py RUN`` takes what ``job=dressing/lead`` left in RUN: each arm begins where the shirt's second
subtask ended, and follows its way by torques of limited size. It appends to ``docs/benchmarks/dressing_way.jsonl`` how many
arms were led in, how many of these are dressed by torques, at which decision, and the largest area ratio. Of the second sleeve with
``--experiment shirt_sleeve_second``.
"""

from __future__ import annotations

import argparse
import datetime
import json
import math
from pathlib import Path

import torch
from by_hand import _GAINS, _TORQUES, WORDS
from rows import append

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

RECORD = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_way.jsonl"


def followed(
    run: Path, portion: str, words: list[str], most: float, ahead: int, experiment: str
) -> dict[str, list[float | None]]:
    """Of each arm of that bank, led by torques of at most so much of the largest to the pose that its way has so many decisions
    `ahead`: the decision at which it was dressed, None where never, at which an episode ended, its largest progress and
    area ratio, and the largest distance from its way, rad."""
    words = [f"experiment=dressing/{experiment}", *WORDS, "episode.seconds=20", "initial_states=bank", f"initial_states.file={run / portion}", *words]  # fmt: skip
    environment = build_environment(load_experiment(words)).environment
    environment.reset(seed=3)
    count = environment.num_worlds
    table, (stiff, damp), torques = environment.table, torch.tensor(_GAINS).T, torch.tensor(_TORQUES)  # fmt: skip
    way = table["way"].clone()
    dressed, ended = torch.full((count,), torch.inf), torch.full((count,), torch.inf)
    inside, torn, error = torch.full((count,), -1.0), torch.zeros(count), torch.zeros(count)
    for k in range(way.shape[1]):
        q, rate = table["qpos"][:, :22], table["qvel"][:, :22]
        wanted = way[:, min(k + ahead, way.shape[1] - 1)]
        before = way[:, max(0, min(k + ahead, way.shape[1] - 1) - 1)]
        action = (stiff * (wanted - q) + damp * ((wanted - before) / 0.04 - rate)) / torques
        step = environment.step(action.clamp(-most, most))
        going = ended.isinf()
        ended = torch.where(step.ended & going, float(k + 1), ended)
        going = ended.isinf()
        inside = torch.where(going, torch.maximum(inside, table["progress"]), inside)
        torn = torch.where(going, torch.maximum(torn, table["area_ratio"]), torn)
        error = torch.where(going, torch.maximum(error, (table["qpos"][:, :22] - way[:, k]).norm(dim=1)), error)  # fmt: skip
        dressed = torch.where((table["dressed"] > 0) & going & dressed.isinf(), float(k + 1), dressed)  # fmt: skip
    environment.close()
    found = {
        "dressed": dressed,
        "ended": ended,
        "progress": inside,
        "area_ratio": torn,
        "error": error,
    }
    return {
        name: [round(one, 3) if math.isfinite(one) else None for one in values.tolist()]
        for name, values in found.items()
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("run", type=Path)
    parser.add_argument("--portion", default="ends", choices=["ends", "low", "half", "near", "out"])
    parser.add_argument(
        "--worlds", type=int, default=16, help="each begins in a state drawn at random"
    )
    parser.add_argument("--edge", type=float, default=0.03)
    parser.add_argument("--most", type=float, default=0.5, help="of each largest torque")
    parser.add_argument(
        "--ahead", type=int, default=0, help="decisions, of the pose that is asked for"
    )
    parser.add_argument("--experiment", default="shirt_sleeve")
    options = parser.parse_args()
    rows = [json.loads(line) for line in (options.run / "metrics.jsonl").open()]
    led = [row["arrived"] for row in rows if "arrived" in row]
    words = [f"scenes.cloth.edge={options.edge}", f"num_worlds={options.worlds}"]
    found = followed(
        options.run, options.portion, words, options.most, options.ahead, options.experiment
    )
    record = {
        "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "edge": options.edge, "experiment": options.experiment, "led": len(led),
        "led_in": int(sum(led)), "portion": options.portion, "most": options.most, "ahead": options.ahead, "worlds": options.worlds,
        "dressed_by_torques": sum(one is not None for one in found["dressed"]), **found,
    }  # fmt: skip
    print(record)
    append(RECORD, record)


if __name__ == "__main__":
    main()
