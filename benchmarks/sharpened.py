"""Table 3.1's skills trained from coarse physics on and at the fine one throughout: samples, success, feet, floor.

``python benchmarks/sharpened.py --seeds 0 1 2 --workers 24`` trains each skill with each seed twice, beside each other on the
processors and GPUs that there are: from 150 Hz on (``resolution.substeps=5``), and at 600 Hz. What was learned is judged as each
training ends, at 600 Hz, and then played on a CPU, where `measured` of ``shipped.py`` says how feet slide and how deep the
body is in the floor. A line of JSON each; they are appended to ``docs/benchmarks/sharpened.jsonl`` as they come. Seconds are
those of trainings that share a machine; several on a GPU want CUDA's Multi-Process Service, and a core each: each line has whether
the service ran (``mps``). After ``--minutes`` trainings are told to save and end, and what they have is recorded as cut; the same command
goes on with them, from ``--runs``. Commands that run at once, of two versions of the code say, are compared if they share a ``--call``.
``--together`` trains nothing: it writes ``sharpened_together.jsonl``, one physics beside the other, a line for each seed of each call.
"""

from __future__ import annotations

import argparse
import ctypes
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterable
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


#: Seconds in which a training that is told to end has to save.
SAVING = 30.0
CUT = "ended by the clock"
#: In the folder of a run of which there is a whole row.
RECORDED = "recorded"


def visible(count: int, given: str | None) -> list[str]:
    """What chooses each of the `count` GPUs that there are: of those that the variable already names, if it does."""
    named = [name.strip() for name in (given or "").split(",") if name.strip()]
    return (named or [str(index) for index in range(count)])[:count]


#: ``CU_DEVICE_ATTRIBUTE_MPS_ENABLED`` of CUDA's driver: whether contexts on a GPU are shared by the Multi-Process Service.
_SHARED = 133


def served() -> bool | None:
    """Whether CUDA's Multi-Process Service serves the first GPU; None where the driver does not say."""
    try:
        driver = ctypes.CDLL("libcuda.so.1")
    except OSError:
        return None
    found = ctypes.c_int()
    failed = driver.cuInit(0) or driver.cuDeviceGetAttribute(ctypes.byref(found), _SHARED, 0)
    return None if failed else bool(found.value)


def train(words: list[str], folder: Path, gpu: str | None, seconds: float) -> str:
    """Train in a process of its own, or go on; returns how it ended: "" or what was wrong."""
    if (folder / "evaluation.json").exists():
        return ""
    what = ["resume", str(folder)] if (folder / "run.json").exists() else ["train", *words]
    command = [sys.executable, "-m", "understudy.command.cli", *what]
    environment = {**os.environ, "OMP_NUM_THREADS": "1"}
    if gpu is not None:
        environment["CUDA_VISIBLE_DEVICES"] = gpu
    log = folder.with_suffix(".log")
    with open(log, "a", encoding="utf-8") as file:
        process = subprocess.Popen(command, env=environment, stdout=file, stderr=file)
        try:
            status = process.wait(seconds)
        except subprocess.TimeoutExpired:
            process.terminate()
            try:
                process.wait(SAVING)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            return CUT
    said = log.read_text(encoding="utf-8").strip().splitlines()
    return f"{folder.name}: {said[-1] if said else status}" if status else ""


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
    """What is known of the run in `folder`, be it cut."""
    metrics = list(open_run(folder).metrics())
    if not metrics:
        return {}
    marks = [m for m in metrics if any(key.startswith("mark/") for key in m)]
    seconds = metrics[-1]["seconds"]
    ended = (folder / "metrics.jsonl").stat().st_mtime  # by the clock, as other commands read it
    found = {
        "samples": metrics[-1]["samples"],
        "training_seconds": round(seconds, 1),
        "span": [round(ended - seconds, 1), round(ended, 1)],
        "sharpened_at": [[m["samples"], round(m["seconds"], 1)] for m in marks],
    }
    if not (folder / "evaluation.json").exists():
        return found
    judged = json.loads((folder / "evaluation.json").read_text(encoding="utf-8"))
    return found | {
        "success_rate": judged["success_rate"],
        "episodes": judged["episodes"],
        "measures": {n: round(m["mean"], 4) for n, m in judged["measures"].items()},
        "played": played(folder),
    }


def at_once(rows: Iterable[dict[str, Any]]) -> dict[tuple[float, float], float]:
    """How many trainings ran in the mean while each one of `rows` did, itself included: by its span."""
    spans = [(began, ended) for r in rows for began, ended in [r.get("span", (0.0, 0.0))]]
    return {
        (began, ended): sum(max(0.0, min(ended, e) - max(began, b)) for b, e in spans) / (ended - began)
        for began, ended in spans
        if ended > began
    }  # fmt: skip


def together(rows: Iterable[dict[str, Any]]) -> list[dict[str, Any]]:
    """One physics beside the other: for each day, number of GPUs, call and seed, over the skills that have both.

    Minutes and samples are sums, of which `ratio` and `samples_ratio` are coarse-then-fine to fine; all else is the
    mean of what coarse-then-fine has more. `at_most` is the ratio of minutes over those skills too whose fine training was cut
    and had taken so long by then. `loaded_ratio` is that of the skills `loaded`, whose two trainings both had at least half as many
    at once as the one that had the most: towards a call's end few share the GPUs, and those that come last are fast.
    """
    rows = list(rows)
    found = {
        (r["when"], r["gpus"], r.get("call", ""), r["seed"], r["skill"], r["physics"]): r
        for r in rows
    }
    more = {
        "from_start": "measures.success_from_clip_start", "from_any_phase": "measures.success_from_any_phase",
        "slide": "played.slide", "sink": "played.sink", "jerk": "played.jerk",
    }  # fmt: skip
    lines = []
    for when, gpus, call, seed in sorted({key[:4] for key in found}):
        pairs = {
            s: [found.get((when, gpus, call, seed, s, physics), {}) for physics in PHYSICS]
            for s in SKILLS
        }
        crowd = at_once(r for key, r in found.items() if key[:3] == (when, gpus, call))
        pairs = {s: pair for s, pair in pairs.items() if all(pair) and not pair[0].get("wrong")}
        pairs = {s: pair for s, pair in pairs.items() if "training_seconds" in pair[1]}
        both = {s: pair for s, pair in pairs.items() if not pair[1].get("wrong")}
        if not both:
            continue
        minutes, least, samples = (
            [sum(pair[i][of] for pair in some.values()) / unit for i in (0, 1)]
            for some, of, unit in (
                (both, "training_seconds", 60),
                (pairs, "training_seconds", 60),
                (both, "samples", 1),
            )
        )
        line = {
            "when": when, "gpus": gpus, **({"call": call} if call else {}), "seed": seed, "skills": list(both), "cut": [s for s in pairs if s not in both],
            "minutes": [round(of, 3) for of in minutes], "ratio": round(minutes[0] / minutes[1], 4),
            "at_most": round(least[0] / least[1], 4),
            "samples": samples, "samples_ratio": round(samples[0] / samples[1], 4),
        }  # fmt: skip
        most = max(crowd.values(), default=0.0)
        loaded = {
            s: pair
            for s, pair in both.items()
            if all(2 * crowd.get(tuple(r.get("span", ())), 0.0) >= most > 0 for r in pair)
        }
        if loaded:
            coarse, fine = (sum(p[i]["training_seconds"] for p in loaded.values()) for i in (0, 1))
            line |= {"loaded": list(loaded), "loaded_ratio": round(coarse / fine, 4)}
        lines.append(
            line
            | {
                name: round(float(np.mean([_at(c, at) - _at(f, at) for c, f in both.values()])), 5)
                for name, at in more.items()
            }
        )
    return lines


def _at(row: dict[str, Any], path: str) -> float:
    first, _, name = path.partition(".")
    return row[first][name]


def recorded(path: Path) -> list[dict[str, Any]]:
    """The rows of the file `path`, if there is one."""
    text = path.read_text(encoding="utf-8") if path.exists() else ""
    return [json.loads(line) for line in text.splitlines()]


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skills", nargs="+", choices=list(SKILLS), default=list(SKILLS))
    parser.add_argument("--seeds", nargs="+", type=int, default=[0, 1, 2])
    parser.add_argument("--physics", nargs="+", choices=list(PHYSICS), default=list(PHYSICS))
    parser.add_argument("--workers", type=int, default=8, help="trainings at once")
    parser.add_argument("--minutes", type=float, default=8.5, help="until trainings are ended")
    parser.add_argument(
        "--runs", type=Path, default=Path("runs/sharpened"), help="of the trainings"
    )
    parser.add_argument("--out", type=Path, default=RESULTS, help="where records are appended")
    parser.add_argument("--call", default="", help="what this is compared with has the same")
    parser.add_argument("--together", action="store_true", help="compare what is recorded")
    parser.add_argument("overrides", nargs="*", help="of every training")
    given = parser.parse_args()
    if given.together:
        lines = together(recorded(given.out))
        text = "".join(json.dumps(line) + "\n" for line in lines)
        given.out.with_name("sharpened_together.jsonl").write_text(text, encoding="utf-8")
        return print(text, end="")
    ends = time.monotonic() + 60 * given.minutes
    gpus = visible(torch.cuda.device_count(), os.environ.get("CUDA_VISIBLE_DEVICES"))
    common = [*TABLE, *(["simulator=mujoco_warp", "num_worlds=512"] if gpus else [])]
    about = {
        "when": time.strftime("%Y-%m-%d"),
        "machine": torch.cuda.get_device_name() if gpus else "CPU",
        "gpus": len(gpus),
        **({"call": given.call} if given.call else {}),
        "mps": served() if gpus else None,
        "at_once": given.workers,
    }

    def work(index: int, skill: str, seed: int, physics: str) -> tuple[Path, dict[str, Any]]:
        folder = given.runs / f"{skill}-{seed}-{physics}"
        found = {**about, "skill": skill, "seed": seed, "physics": physics}
        if (left := ends - time.monotonic()) <= 0:
            return folder, {}
        words = [
            f"experiment=spacetime/{skill}", f"seed={seed}", *common, *SKILLS[skill], PHYSICS[physics],
            *given.overrides, f"run.dir={folder}",
        ]  # fmt: skip
        # What is compared shares a GPU.
        gpu = gpus[index // len(given.physics) % len(gpus)] if gpus else None
        wrong = train(words, folder, gpu, left)
        return folder, found | ({"wrong": wrong} if wrong else {})

    given.runs.mkdir(parents=True, exist_ok=True)
    if gpus:  # which compiles the kernels, for all of them
        with tempfile.TemporaryDirectory() as first:
            words = [f"experiment=spacetime/{given.skills[0]}", *common, "budget.samples=1"]
            train([*words, f"run.dir={first}/run"], Path(first, "run"), gpus[0], 200.0)
    # Longest first, so that none is left alone at the end; the two physics of one beside each other.
    jobs = [(s, n, p) for s in given.skills for n in given.seeds for p in given.physics]
    jobs = [job for job in jobs if not (given.runs / "-".join(map(str, job)) / RECORDED).exists()]
    with ThreadPoolExecutor(given.workers) as pool:
        waiting = [pool.submit(work, index, *job) for index, job in enumerate(jobs)]
        for future in as_completed(waiting):
            folder, found = future.result()
            if not found:
                continue
            if (folder / "run.json").exists():  # measured one after the other, while others train
                found |= row(folder)
            print(line := json.dumps(found), flush=True)
            with open(given.out, "a", encoding="utf-8") as file:
                file.write(line + "\n")
            if not found.get("wrong"):
                (folder / RECORDED).touch()
    return None


if __name__ == "__main__":
    main()
