"""How far a shirt's cloth is stretched while the arms in it move at random: what `reward=dressing/deformation` has to tell apart.

``python benchmarks/stretch.py`` appends, for each of several sizes of the policy's noise, the quantiles over worlds of an episode's
largest area ratio, and of every decision's but that which ends it, to ``docs/benchmarks/dressing_stretch.jsonl``. On a CPU core 8 worlds take some 6 minutes each.
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path

import torch
from rows import append

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

RECORD = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_stretch.jsonl"
SHARES = (0.05, 0.25, 0.5, 0.75, 0.95, 1.0)


def stretched(
    task: str, noise: float, worlds: int, decisions: int, others: list[str]
) -> dict[str, object]:
    words = [f"experiment=dressing/{task}", "device=cpu", "simulators.person.name=mujoco", *others]
    built = build_environment(load_experiment([*words, f"num_worlds={worlds}"]))
    environment, drawn = built.environment, torch.Generator().manual_seed(0)
    environment.reset(seed=0)
    alive, found = torch.ones(worlds, dtype=torch.bool), []
    for _ in range(decisions):
        step = environment.step(
            noise * torch.randn(worlds, environment.action_size, generator=drawn)
        )
        alive &= ~(step.terminated | step.truncated)
        ratio = environment.table["area_ratio"].clone()
        found.append(torch.where(alive, ratio, torch.nan))
    environment.close()
    ratios = torch.stack(found)
    largest = torch.nan_to_num(ratios, nan=0.0).amax(dim=0)

    def quantiles(of: torch.Tensor) -> dict[str, float]:
        share = torch.tensor(SHARES)
        values = torch.quantile(of[~of.isnan()], share)
        return {
            f"p{round(100 * s)}": round(float(v), 3) for s, v in zip(SHARES, values, strict=True)
        }

    return {
        "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "experiment": f"dressing/{task}",
        "words": others, "noise": noise, "worlds": worlds, "decisions": decisions, "largest": quantiles(largest),
        "of_decisions": quantiles(ratios.flatten()),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--task", default="shirt_grip")
    parser.add_argument("--noise", type=float, nargs="+", default=[0.0, 0.1, 0.3])
    parser.add_argument("--worlds", type=int, default=8)
    parser.add_argument("--decisions", type=int, default=50)
    parser.add_argument("others", nargs="*", help="as scenes.person.self_collision=false")
    words = parser.parse_args()
    for noise in words.noise:
        row = stretched(words.task, noise, words.worlds, words.decisions, words.others)
        print(row, flush=True)
        append(RECORD, row)


if __name__ == "__main__":
    main()
