"""Table 3.1's skills trained from coarse physics on and at the fine one throughout: samples, success, feet, floor.

``python benchmarks/sharpened.py --seeds 1 2 --workers 16`` trains each skill with each seed twice, beside each other on the
processors and GPUs that there are: from 150 Hz on (``resolution.substeps=5``), and at 600 Hz. What was learned is judged as each
training ends, at 600 Hz, and then played on a CPU, where `measured` of ``shipped.py`` says how feet slide and how deep the
body is in the floor. A line of JSON each; they are appended to ``docs/benchmarks/sharpened.jsonl`` as they come. Seconds are
those of trainings that share a machine. What is not finished after ``--minutes`` is ended and said to be so.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor, as_completed
from pathlib import Path
from typing import Any

import numpy as np
import torch
from shipped import SECONDS, measured

from understudy.records.runs import open_run
from understudy.setup.plugins import installed
from understudy_characters.character import load_character
from understudy_play.command import record
from understudy_play.player import Player
from understudy_skills.skill import open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "sharpened.jsonl"
#: Longest first, each as the table's reproduction has it.
SKILLS = {
    "backflip": [],
    "run_jump": [],
    "dance_a": [],
    "roll": ["evaluation.starts.clip_start.window=0.04"],
    "jump": [],
    "cartwheel": [],
    "run": [],
    "walk": ["motion.name=humanoid3d_walk"],
}
TABLE = [
    "evaluation.success=survived",
    "evaluation.starts.clip_start.name=spacetime/clip_start",
    "evaluation.starts.any_phase.name=characters/reference_states",
    "run.video_seconds=0",
]
PHYSICS = {"coarse_then_fine": "resolution.substeps=5", "fine": "resolution.substeps=null"}
#: Played from so many starts.
PLAYS = 4


def train(name: str, words: list[str], folder: Path, gpu: str | None, seconds: float) -> str:
    """Train in a process of its own; returns how it ended: "" or what was wrong."""
    command = [sys.executable, "-m", "understudy.command.cli", "train", *words, f"run.dir={folder}"]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = gpu
    log = folder.with_suffix(".log")
    try:
        with open(log, "w", encoding="utf-8") as file:
            subprocess.run(
                command, env=environment, stdout=file, stderr=file, check=True, timeout=seconds
            )
    except subprocess.TimeoutExpired:
        return "ended by the clock"
    except subprocess.CalledProcessError:
        return f"{name}: {log.read_text(encoding='utf-8').strip().splitlines()[-1]}"
    return ""


def played(folder: Path) -> dict[str, float]:
    """What the policy does at the fine physics: the mean of its plays, of depth the most."""
    torch.set_num_threads(1)
    skill = open_skill(str(folder), ["simulator=mujoco", "device=cpu", "num_worlds=1"])
    character = load_character(
        str(skill.card["config"]["scene"]["character"]), installed().registry
    )
    player = Player(skill)
    found = []
    try:
        for _ in range(PLAYS):
            found.append(measured(record(player, SECONDS)["qpos"], player.dt, character))
            player.restart()
        falls = player.falls
    finally:
        player.close()
    most = {"sink": max(one["sink"] for one in found)}
    means = {name: float(np.mean([one[name] for one in found])) for name in found[0]}
    return {name: round(value, 4) for name, value in (means | most).items()} | {"falls": falls}


def row(folder: Path) -> dict[str, Any]:
    """What is known of the finished run in `folder`."""
    run = open_run(folder)
    metrics = list(run.metrics())
    judged = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    marks = [m for m in metrics if any(key.startswith("mark/") for key in m)]
    return {
        "samples": metrics[-1]["samples"],
        "training_seconds": round(metrics[-1]["seconds"], 1),
        "sharpened_at": [[m["samples"], round(m["seconds"], 1)] for m in marks],
        "success_rate": judged["success_rate"],
        "episodes": judged["episodes"],
        "measures": {n: round(m["mean"], 4) for n, m in judged["measures"].items()},
        "played": played(folder),
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skills", nargs="+", choices=list(SKILLS), default=list(SKILLS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[1, 2])
    parser.add_argument("--physics", nargs="+", choices=list(PHYSICS), default=list(PHYSICS))
    parser.add_argument("--workers", type=int, default=8, help="trainings at once")
    parser.add_argument("--minutes", type=float, default=8.5, help="until trainings are ended")
    parser.add_argument("--runs", type=Path, help="the folder of runs; else a temporary one")
    parser.add_argument("--out", type=Path, default=RESULTS, help="where records are appended")
    parser.add_argument("overrides", nargs="*", help="of every training")
    given = parser.parse_args()
    gpus = [str(index) for index in range(torch.cuda.device_count())]
    common = [*TABLE, *(["simulator=mujoco_warp", "num_worlds=512"] if gpus else [])]
    ends = time.monotonic() + 60 * given.minutes
    about = {
        "when": time.strftime("%Y-%m-%d"),
        "machine": torch.cuda.get_device_name() if gpus else "CPU",
        "gpus": len(gpus),
        "at_once": given.workers,
    }

    def work(index: int, skill: str, seed: int, physics: str) -> dict[str, Any]:
        folder = given.runs / f"{skill}-{seed}-{physics}"
        words = [
            f"experiment=spacetime/{skill}", f"seed={seed}", *common, *SKILLS[skill], PHYSICS[physics],
            *given.overrides,
        ]  # fmt: skip
        found: dict[str, Any] = {"skill": skill, "seed": seed, "physics": physics}
        gpu = gpus[index % len(gpus)] if gpus else None
        wrong = train(folder.name, words, folder, gpu, max(1.0, ends - time.monotonic()))
        return (
            {**about, **found, "wrong": wrong} if wrong else {**about, **found, "run": str(folder)}
        )

    with tempfile.TemporaryDirectory() as temporary:
        given.runs = given.runs or Path(temporary)
        given.runs.mkdir(parents=True, exist_ok=True)
        if gpus:  # which compiles the kernels, for all of them
            words = [f"experiment=spacetime/{given.skills[0]}", *common, "budget.samples=1"]
            train("first", words, given.runs / "first", gpus[0], 200.0)
        jobs = [(s, n, p) for n in given.seeds for s in given.skills for p in given.physics]
        with ThreadPoolExecutor(given.workers) as pool:
            waiting = [pool.submit(work, index, *job) for index, job in enumerate(jobs)]
            for future in as_completed(waiting):
                found = future.result()
                if "run" in found:  # measured one after the other, while others train
                    found |= row(Path(found.pop("run")))
                print(line := json.dumps(found), flush=True)
                with open(given.out, "a", encoding="utf-8") as file:
                    file.write(line + "\n")


if __name__ == "__main__":
    main()
