"""Whether evolved initial states are farthest from the clip where it turns (thesis, figure 3.13), of trainings with
``initial_states=spacetime/evolution``.

``python benchmarks/evolved.py RUN…`` adds a line to ``docs/benchmarks/evolved.jsonl`` for each: by segment of the clip how far the newest
checkpoint's initial states are from the reference at the same moments (the mean over joints, rad) and how fast the clip's root turns there
(rad/s), and Spearman's rank correlation of the two.
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path

import numpy as np
import torch

from understudy.records.runs import open_run
from understudy_characters.initial_states import reference_states
from understudy_characters.scene import reference_motion
from understudy_spacetime.section import context_of, evolution_of

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "evolved.jsonl"


def row(folder: str) -> dict[str, object]:
    run = open_run(folder)
    distances = evolution_of(run).distances
    segments, states = distances.shape
    context = context_of(run)
    reference = reference_motion(context)
    at = (torch.arange(segments * states) + 0.5) / (segments * states) * reference.duration
    dof = 3  # of qvel, after the root's three of position
    rates = reference_states(reference, at)["qvel"][:, dof : dof + 3].norm(dim=1)
    turns = rates.view(segments, states).mean(1).numpy()
    away = distances.mean(1)
    ranks = np.argsort(np.argsort([away, turns], axis=1), axis=1)
    return {
        "clip": run.info["config"]["motion"]["name"],
        "seed": run.info["config"]["seed"] or 0,
        "when": datetime.date.today().isoformat(),
        "samples": run.judged(),
        "correlation": float(torch.corrcoef(torch.from_numpy(ranks).double())[0, 1]),
        "away_rad": [round(float(x), 4) for x in away],
        "turns_rad_s": [round(float(x), 3) for x in turns],
    }


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("runs", nargs="+")
    with RESULTS.open("a", encoding="utf-8") as file:
        for one in parser.parse_args().runs:
            file.write((line := json.dumps(row(one))) + "\n")
            print(line)
