"""How deep fingers are in the sticks, and how far these slip, by how contacts are solved; no policy (thesis, figures 5.24 and 5.25).

``python benchmarks/contacts.py`` holds packaged grips of sticks for ten seconds at each of their angles under fixed targets, and has hands
follow plans of relocation by the plans' targets alone, under several settings each; the packaged policy of relocation is judged on unseen
plans under settings that it was not trained with, solved to the end. It writes ``docs/benchmarks/contacts.jsonl``, a row a
grip and setting. What is there already is not measured again, so the same command goes on after a stop.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from held import episodes, measured

from understudy.errors import ConfigError
from understudy.setup.building import Built, build_environment
from understudy.setup.composition import load_experiment
from understudy_gripping.grip import load_grip, long, standard, tri_finger
from understudy_hand.scene import HandScene
from understudy_mujoco.contact import Contact
from understudy_reinforcement.evaluation import wilson_interval
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "contacts.jsonl"
GRIPS = {"standard": standard(), "long": long(), "tri_finger": tri_finger()}
PLANS = {"standard": "relocate", "long": "relocate_long", "tri_finger": "relocate_tri_finger"}
SECONDS, SETTLE = 10.0, 1.0
SKILL = "chopsticks/relocate"
#: What makes a row another one.
KEYS = ("of", "grip", "setting", "step_ms")
#: By what is changed: scene.contact, and s of a step. The first is how hands are trained on a GPU.
OURS = {"impratio": 30.0, "iterations": 10, "ls_iterations": 10, "solimp": (0.99, 0.99, 0.01)}
SETTINGS: dict[str, dict[str, Any]] = {
    "as trained": {},
    "solimp 0.85, 0.9, 0.001": {"solimp": (0.85, 0.9, 0.001)},
    "solimp 0.9, 0.95, 0.001": {"solimp": (0.9, 0.95, 0.001)},
    "solimp 0.95, 0.99, 0.001": {"solimp": (0.95, 0.99, 0.001)},
    "solimp 0.995, 0.995, 0.01": {"solimp": (0.995, 0.995, 0.01)},
    "solimp 0.999, 0.999, 0.01": {"solimp": (0.999, 0.999, 0.01)},
    "impratio 1": {"impratio": 1.0, "iterations": 20, "ls_iterations": 20},
    "impratio 10": {"impratio": 10.0},
    "impratio 100": {"impratio": 100.0, "iterations": 20, "ls_iterations": 20},
    "impratio 1000": {"impratio": 1000.0, "iterations": 50, "ls_iterations": 50},
    "solved to the end": {"iterations": 100, "ls_iterations": 50},
}
#: Under which a trained policy is judged beside those of softness.
IMPRATIOS = (1.0, 3.0, 10.0, 100.0, 300.0, 1000.0)


def of_grip(path: Path, contact: Mapping[str, Any], step: float) -> dict[str, Any]:
    """At the worst of its angles, mm."""
    grip = load_grip(path)
    options = HandScene.Options(
        **asdict(grip.measures), tool=grip.tool, contact=Contact(**{**OURS, **contact})
    )
    scene = HandScene(options)
    scene.timestep = step
    every = [grip.held(scene, k, SECONDS, SETTLE) for k in range(len(grip.angles))]
    fell = [held.fell for held in every if held.fell is not None]
    return {
        "fell": len(fell),
        "first_fell": round(min(fell), 3) if fell else None,
        "slip": None if fell else 1e3 * float(np.max([held.drift for held in every])),
        "depth": 1e3 * max(held.depth for held in every),
    }


@torch.no_grad()
def of_plans(name: str, contact: Mapping[str, Any], substeps: int, count: int) -> dict[str, Any]:
    """Of `count` plans, each followed to its end or until something is lost; mm, the deepest of all frames."""
    chosen = {**OURS, **contact}
    words = [
        f"experiment=chopsticks/{name}", "simulator=mujoco", "simulator.threads=1", "device=cpu", f"num_worlds={count}",
        f"initial_states.plans={count}", "initial_states.refill=0", "actuation.hand=0", "actuation.arm=0",
        "scene.object.rolling=0.0005", f"control.substeps={substeps}",
        *(f"scene.contact.{key}={list(v) if isinstance(v, tuple) else v}" for key, v in chosen.items()),
    ]  # fmt: skip
    experiment = load_experiment(words)
    try:
        built = build_environment(experiment, num_worlds=count, evaluating=True)
    except ConfigError as error:  # a grip that falls at once begins no plan
        return {"plans": 0, "refused": str(error)}
    still = torch.zeros(count, built.environment.action_size)
    each, frames, _ = _followed(built, lambda seen: still)
    return {
        "plans": count,
        "frames": frames,
        "fingers": max(one["fingers"] for one in each),
        "fingers_median": float(np.median([one["fingers"] for one in each])),
        "object": max(one["object"] for one in each),
    }


def _followed(
    built: Built, act: Callable[[Any], torch.Tensor]
) -> tuple[list[dict[str, float]], int, int]:
    """What is measured of each world's plan, followed by `act` to its end or until something is lost; frames in all;
    and how many were placed."""
    environment, scene = built.environment, built.context.scene
    assert isinstance(scene, HandScene)
    try:
        seen, placed = environment.reset(0, "contacts"), 0
        count = len(environment.table["qpos"])
        frames: list[list[np.ndarray]] = [[] for _ in range(count)]
        running = torch.ones(count, dtype=torch.bool)
        while bool(running.any()):
            qpos = environment.table["qpos"].numpy().copy()
            for world in running.nonzero()[:, 0].tolist():
                frames[world].append(qpos[world].astype(np.float64))
            step = environment.advance(act(seen))
            placed += int((running & step.endings["placed"]).sum())
            seen, running = step.observations, running & ~step.ended
        each = [measured(scene, np.array(rows), 0.01) for rows in frames if len(rows) > 4]
    finally:
        environment.close()
    return each, sum(map(len, frames)), placed


@torch.no_grad()
def of_policy(contact: Mapping[str, Any], substeps: int, count: int) -> dict[str, Any]:
    """The packaged policy of relocation on `count` unseen plans; mm: the deepest and the farthest slip of each plan, their median over
    plans and the most."""
    chosen = {**OURS, "iterations": 100, "ls_iterations": 50, **contact}
    words = [
        f"initial_states.plans={count}", "initial_states.refill=0", "scene.object.rolling=0.0005", f"control.substeps={substeps}",
        *(f"scene.contact.{key}={list(v) if isinstance(v, tuple) else v}" for key, v in chosen.items()),
    ]  # fmt: skip
    skill = open_skill(SKILL, words)
    try:
        built = build_environment(skill.experiment, num_worlds=count, evaluating=True)
    except ConfigError as error:
        return {"plans": 0, "refused": str(error)}
    policy = build_policy(skill.experiment, built.context)
    skill.give(policy)
    each, frames, placed = _followed(built, lambda seen: policy.distribution(seen).mode())
    found: dict[str, Any] = {"plans": count, "frames": frames, "placed": placed / count}
    found["placed_95"] = list(wilson_interval(placed / count, count))
    for name in ("fingers", "object", "slip"):
        of = [one[name] for one in each]
        found |= {name: max(of), f"{name}_median": float(np.median(of))}
    return found


def of_skill(setting: str, substeps: int) -> dict[str, Any]:
    """The packaged skill of relocation, played for some seconds; mm."""
    words = [f"control.substeps={substeps}"]
    if (share := setting.rpartition(" ")[2]).startswith("0."):
        words.append(f"scene.contact.solimp=[{share}, {share}, 0.01]")
    each, frames, failures = episodes(open_skill(SKILL, words), 8.0)
    return {
        "frames": frames, "failures": failures,
        "fingers": max(one["fingers"] for one in each), "object": max(one["object"] for one in each),
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument(
        "--plans", type=int, default=8, help="that a hand follows, for each setting"
    )
    parser.add_argument("--tasks", type=int, default=50, help="that a policy is judged on")
    parser.add_argument("--machine", default="one CPU core")
    parser.add_argument("--out", type=Path, default=RESULTS)
    given = parser.parse_args()
    torch.set_num_threads(1)
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    rows = [json.loads(line) for line in lines]
    there = {tuple(row[key] for key in KEYS) for row in rows}

    def add(row: dict[str, Any], found: dict[str, Any]) -> None:
        rows.append(
            {
                **row, "when": datetime.date.today().isoformat(), "device": "cpu", "machine": given.machine,
                "simulator": "mujoco", **found,
            }
        )  # fmt: skip
        given.out.write_text("".join(json.dumps(r) + "\n" for r in rows), encoding="utf-8")
        print(json.dumps(rows[-1]), flush=True)

    for setting in ("as packaged", "solimp 0.995", "solimp 0.998"):
        for substeps in (2, 4):
            key = ("skill", "standard", setting, 10.0 / substeps)
            if key not in there:
                add(dict(zip(KEYS, key, strict=True)), of_skill(setting, substeps))
    softness = {name: of for name, of in SETTINGS.items() if name.startswith("solimp")}
    judged = {
        "as trained": {},
        **softness,
        **{f"impratio {k:g}": {"impratio": k} for k in IMPRATIOS},
    }
    for setting, contact in judged.items():
        for substeps in (2, 1):
            key = ("policy", "standard", setting, 10.0 / substeps)
            if key not in there:
                found = of_policy(contact, substeps, given.tasks)
                add(dict(zip(KEYS, key, strict=True)), found)
    for grip, path in GRIPS.items():
        for setting, contact in SETTINGS.items():
            for substeps in (2, 1, 4):
                step = 0.01 / substeps
                for of in ("grip", "plans"):
                    if (of, grip, setting, 1e3 * step) in there:
                        continue
                    # Finer steps and plans: only what tells why fingers sink.
                    if of == "plans" and (substeps == 1 or setting.startswith("impratio")):
                        continue
                    if substeps == 4 and setting not in ("as trained", "solved to the end"):
                        continue
                    found = (
                        of_grip(path, contact, step)
                        if of == "grip"
                        else of_plans(PLANS[grip], contact, substeps, given.plans)
                    )
                    add(dict(zip(KEYS, (of, grip, setting, 1e3 * step), strict=True)), found)


if __name__ == "__main__":
    main()
