"""How long a plan takes on one core, how many random tasks are planned, and how near plans come to anything.

Eight objects of table 5.2 (thesis, section 5.6) lie on a table and are moved one after another, each plan from where
the last one ended; then eight others. Each is asked for ``--times`` times: on a machine with other work the least
is nearest to what a core of one's own takes. Prints one line and appends it to ``docs/benchmarks/planner.jsonl``.

    python benchmarks/planner.py --tasks 500
    python benchmarks/planner.py --grip long --tasks 100
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import time
from collections import Counter
from pathlib import Path

import numpy as np
import torch
from rows import append

from understudy.records.runs import versions
from understudy.setup.plugins import installed
from understudy_gripping.grip import load_grip
from understudy_hand.scene import HandScene
from understudy_tool_planner.configuration import NoPlan
from understudy_tool_planner.planner import Planner
from understudy_tool_planner.tasks import Table, random_goal, random_table

RESULTS = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "planner.jsonl"


def main() -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--tasks", type=int, default=500)
    parser.add_argument("--objects", type=int, default=8)
    parser.add_argument(
        "--grip",
        default="standard",
        help="that comes with a plugin, of any hand, of sticks or tongs",
    )
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--times", type=int, default=1, help="that each plan is asked for")
    parser.add_argument("--out", type=Path, default=RESULTS)
    options = parser.parse_args()
    torch.set_num_threads(1)
    grip = load_grip(installed().registry.find("grip", options.grip).factory())
    hand = grip.measures
    scene = HandScene(HandScene.Options(hand.fingers, hand.finger_length, hand.size, grip.tool))
    planner = Planner(grip, scene)
    generator = torch.Generator().manual_seed(options.seed)
    now, taken, clear, lengths = planner.begin(), [], [], []
    wall, fastest, reasons = [], [], Counter[str]()
    table = Table((), (), ())
    for number in range(options.tasks):
        one = number % options.objects
        if one == 0:
            table, now = random_table(generator, options.objects), planner.begin()
        goal = random_goal(table, one, generator)
        task, others = table.task(one, goal), table.without(one)
        plan, refused, spent = None, "", []
        for _ in range(options.times):
            began, clock = time.process_time(), time.perf_counter()
            try:
                plan = planner.plan(task, now, others)
            except NoPlan as error:
                refused = str(error)
            spent.append((time.process_time() - began, time.perf_counter() - clock))
        taken.append(spent[0][0])
        wall.append(spent[0][1])
        fastest.append(min(spent)[0])
        if refused:
            reasons[refused] += 1
        if plan is not None:
            clear.append(plan.clearance)
            lengths.append(plan.seconds)
            table, now = table.moved(one, goal), plan.end
    row = {
        "when": time.strftime("%Y-%m-%d"),
        "cpu": platform.processor() or platform.machine(),
        "versions": versions(),
        "grip": options.grip,
        "tasks": options.tasks,
        "objects": options.objects,
        "planned": len(clear) / options.tasks,
        "processor_ms": _percentiles(taken),
        "wall_ms": _percentiles(wall),
        "times": options.times,
        "fastest_processor_ms": _percentiles(fastest),
        "load": round(os.getloadavg()[1], 1),
        "least_clearance_mm": round(1e3 * min(clear), 4),
        "median_clearance_mm": round(1e3 * float(np.median(clear)), 3),
        "median_plan_s": round(float(np.median(lengths)), 2),
        "reasons": dict(reasons),
    }
    print(json.dumps(row))
    append(options.out, row)


def _percentiles(seconds: list[float]) -> list[float]:
    """ms: the median, the 95th percentile, and the most."""
    return np.percentile(1e3 * np.array(seconds), [50, 95, 100]).round(1).tolist()


if __name__ == "__main__":
    main()
