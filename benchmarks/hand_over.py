"""In which states sitting's controller changes to its sit, beside those from which a clip of sitting begins.

``python benchmarks/hand_over.py BANK`` reads what ``understudy train experiment=sitting/switches job.run=sitting/meta job.value=3`` leaves;
``--note`` adds the row to ``docs/benchmarks/sitting/hand_over.jsonl``. Distances are from the seat's middle, in the chair's frame; ``leaves`` is how fast
it goes away from the chair, m/s.
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path
from typing import Any

import torch
from torch import Tensor

from understudy_skills import bank
from understudy_tensors import rotations

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "sitting" / "hand_over.jsonl"
BEGINS = 0.45  #: m before the seat's middle at which the clip of sitting begins, standing still


def quantiles(values: Tensor) -> dict[str, float]:
    """What 5, 50 and 95 % of them lie below."""
    return {f"p{p}": float(torch.quantile(values.double(), p / 100)) for p in (5, 50, 95)}


def row(folder: str, note: str) -> dict[str, Any]:
    """Of the states banked in `folder`: where they are, how they face, how fast they go."""
    states = bank.load(Path(folder))
    qpos, qvel = states["qpos"], states["qvel"]
    chair = rotations.heading(states["mocap_quat/chair"])
    away = rotations.turned_flat(qpos[:, :2] - states["mocap_pos/chair"][:, :2], -chair)
    leaves = rotations.turned_flat(qvel[:, :2], -chair)[:, 0]
    off = rotations.wrapped(rotations.heading(qpos[:, 3:7]) - chair).abs().rad2deg()
    ahead, aside = away[:, 0], away[:, 1].abs()
    measured = {
        "pelvis": qpos[:, 2], "ahead": ahead, "aside": aside, "off": off, "leaves": leaves,
        "speed": qvel[:, :2].norm(dim=1), "turning": qvel[:, 5].abs(),
    }  # fmt: skip
    # each axis by itself, as `sitting/from_reference` draws the chair's place
    metres = torch.maximum((ahead - BEGINS).abs(), aside)
    within = {
        f"cm{100 * m:.0f}_degrees{d:.0f}": float(((metres <= m) & (off <= d)).float().mean())
        for m, d in ((0.05, 30.0), (0.1, 30.0), (0.25, 60.0))
    }
    return {
        "bank": note, "when": datetime.date.today().isoformat(), "machine": "MuJoCo on a CPU core",
        "states": len(qpos), "within": within,
        "quantiles": {name: quantiles(values) for name, values in measured.items()},
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("bank", help="the folder of a harvest")
    parser.add_argument("--note", default="", help="keep the row, under this name")
    given = parser.parse_args()
    found = row(given.bank, given.note)
    print(json.dumps(found, indent=1, ensure_ascii=False))
    if given.note:
        with RESULTS.open("a", encoding="utf-8") as file:
            file.write(json.dumps(found, ensure_ascii=False) + "\n")


if __name__ == "__main__":
    main()
