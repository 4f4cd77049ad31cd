"""Whether what hands do is to be believed: each packaged skill of a hand, played.

``python benchmarks/held.py`` plays every skill of a hand that `understudy play` lists, measures how deep fingers are in the
sticks and sticks in the object, and how far the lower stick slips in the hand, and writes ``docs/benchmarks/held.jsonl``, from which
``make figures`` writes a table in the gallery.
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np

from understudy_hand.scene import HandScene
from understudy_hand.tools import BODIES
from understudy_play.command import record
from understudy_play.player import Player
from understudy_skills.skill import Skill, names, open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "held.jsonl"
SECONDS = 8.0
#: mm: the deepest that fingers may be in sticks, anything in the object; how far the lower stick may slip in the palm.
THRESHOLDS = {"fingers": 1.0, "object": 1.0, "slip": 5.0}
#: rad: a hinge that turns farther within a frame begins a new episode.
JUMP = 0.15


def hands() -> list[str]:
    """The packaged skills of hands."""
    return [name for name in names() if open_skill(name).card["config"]["scene"]["name"] == "hand"]


def measured(scene: HandScene, qpos: np.ndarray, dt: float) -> dict[str, float]:
    """Of a motion (T, nq), mm: ``fingers``, the deepest that a finger is in a stick, and ``object``, that anything is in the object;
    ``slip``, how far the lower stick moves in the palm; and median ``jerk`` of the hinges, rad/s³."""
    model, data = scene.model, mujoco.MjData(scene.model)
    sticks = {model.body(name).id for name in BODIES[scene.options.tool]}
    thing = model.body("object").id if scene.options.object is not None else -1
    palm, lower = model.body("palm").id, model.body(scene.tool_bodies[1]).id
    deep, places = {"fingers": 0.0, "object": 0.0}, []
    for frame in qpos:
        data.qpos[:] = frame
        mujoco.mj_kinematics(model, data)
        mujoco.mj_comPos(model, data)
        mujoco.mj_collision(model, data)
        for contact in data.contact:
            bodies = {int(model.geom_bodyid[k]) for k in contact.geom}
            kind = "object" if thing in bodies else "fingers" if bodies & sticks else None
            if kind is not None:
                deep[kind] = max(deep[kind], -1e3 * float(contact.dist))
        turn = data.xmat[palm].reshape(3, 3)
        places.append(turn.T @ (data.xpos[lower] - data.xpos[palm]))
    third = np.diff(qpos[:, : scene.hinges], n=3, axis=0) / dt**3
    whole = np.array(places)
    return {
        **deep,
        "slip": 1e3 * float(np.linalg.norm(whole - whole[0], axis=1).max()),
        "jerk": float(np.median(np.linalg.norm(third, axis=1))),
    }


def episodes(skill: Skill, seconds: float) -> tuple[list[dict[str, float]], int, int]:
    """What is measured of each whole episode that a hand plays within the time, which are apart since it jumps from one
    to the next; their frames; and how many failed."""
    player = Player(skill)
    try:
        tracks, scene, dt, failures = record(player, seconds), player.scene, player.dt, player.falls
    finally:
        player.close()
    assert isinstance(scene, HandScene)
    qpos = tracks["qpos"]
    jumps = np.abs(np.diff(qpos[:, : scene.hinges], axis=0)).max(1) > JUMP
    parts = [part for part in np.split(qpos, np.flatnonzero(jumps) + 1) if len(part) > 3]
    return [measured(scene, part, dt) for part in parts], len(qpos), failures


def row(name: str, words: list[str]) -> dict[str, Any]:
    """The skill `name` with the overrides `words`, played from where it begins."""
    skill = open_skill(name, words)
    found, _, failures = episodes(skill, SECONDS)
    played = {key: max(one[key] for one in found) for key in (*THRESHOLDS, "jerk")}
    return {
        "skill": name,
        "when": datetime.date.today().isoformat(),
        "seconds": SECONDS,
        "seed": 0,
        "samples": skill.samples,
        "success": (skill.card["evaluation"] or {}).get("success_rate"),
        "episodes": len(found),
        "failures": failures,
        "played": played,
        "beyond": ", ".join(k for k, most in THRESHOLDS.items() if played[k] > most) or "–",
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skill", help="a packed one (.json), which is printed alone")
    parser.add_argument("words", nargs="*", metavar="KEY=VALUE", help="of that one")
    given = parser.parse_args()
    if given.skill is not None:
        print(json.dumps(row(given.skill, given.words)))
        return
    lines = []
    for one in hands():
        lines.append(json.dumps(row(one, [])) + "\n")
        print(lines[-1], end="", flush=True)
    RESULTS.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
