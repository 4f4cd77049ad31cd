"""What the pose auto-encoder makes of held-out clips, beside principal components (thesis, section 4.4.2).

``UNDERSTUDY_DATA=… python benchmarks/pose_vae.py --seeds 0 1 2 --jobs 2`` trains ``experiment=pose_vae/poses`` with the divergence's weight
as the section has it and as the authors' release does, 128 times as large; each seed holds out other clips. A line of JSON
each, and one of the principal components of the same clips, is appended to ``docs/benchmarks/pose_vae.jsonl``; what is there is not
trained again.
"""

from __future__ import annotations

import argparse
import json
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path
from typing import Any

import numpy as np
import torch

from understudy_pose_vae import pictures
from understudy_sweeps.loops import Trial, Work
from understudy_sweeps.trial import run_trial

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "pose_vae.jsonl"
BETAS = {"as the section has it": 1e-5, "summed over the batch": 1.28e-3}
NAMES = ("rotation_error", "position_error", "explained_variance")


def trained(weight: str, seed: int) -> list[dict[str, Any]]:
    """The row of one auto-encoder, and that of principal components on its clips."""
    torch.set_num_threads(1)
    began = time.monotonic()
    with tempfile.TemporaryDirectory() as folder:
        words = ("experiment=pose_vae/poses", f"job.beta={BETAS[weight]}", "run.video_seconds=0")
        *_, report = run_trial(Trial("poses", seed=seed), Work(words, folder))
        assert report is not None
        if report.status != "ok":
            raise RuntimeError(report.status)
        with np.load(Path(report.run, pictures.FILE)) as made:
            principal, explained = made["principal"].tolist(), made["explained"].tolist()
            latent, poses = int(made["latent"]), made["poses"].tolist()
    row = {"seed": seed, "when": time.strftime("%Y-%m-%d"), "codes": latent, "poses": poses}
    seconds = round(time.monotonic() - began, 1)
    measures = {name: report.measures[name] for name in NAMES}
    return [
        {"what": "auto-encoder", "divergence": weight, **row, **measures}
        | {"samples": report.cost, "seconds": seconds},
        {"what": "principal components", "divergence": weight, **row}
        | dict(zip(NAMES, principal, strict=True))
        | {"covered": explained[latent - 1], "covered_by_one_more": explained[latent]},
    ]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--jobs", type=int, default=1)
    given = parser.parse_args()
    text = RESULTS.read_text(encoding="utf-8") if RESULTS.exists() else ""
    done = {(row["divergence"], row["seed"]) for row in map(json.loads, text.splitlines())}
    jobs = [(weight, seed) for seed in given.seeds for weight in BETAS]
    with ProcessPoolExecutor(given.jobs, get_context("forkserver")) as pool:
        ends = [pool.submit(trained, *job) for job in jobs if job not in done]
        for end in ends:
            lines = [json.dumps(row) + "\n" for row in end.result()]
            print("".join(lines), end="", flush=True)
            with RESULTS.open("a", encoding="utf-8") as file:
                file.write("".join(lines))


if __name__ == "__main__":
    main()
