"""Whether the packaged grips hold without a policy.

``python benchmarks/grips.py`` holds each for ten seconds at each of its angles under fixed targets, measures how far the tool slips in
the palm and how deep anything is in it, and writes ``docs/benchmarks/grips.jsonl``, from which ``make figures`` writes a table on
the page of chopsticks. ``--device cuda`` holds the standard one in MuJoCo Warp instead, parallel, in many worlds, and appends a row to
``docs/benchmarks/grips_warp.jsonl``.
"""

from __future__ import annotations

import argparse
import datetime
import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from held import measured

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import load
from understudy_gripping.grip import load_grip
from understudy_gripping.styles import written
from understudy_hand.scene import HandScene

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "grips.jsonl"
WARP = RESULTS.with_name("grips_warp.jsonl")
SECONDS, SETTLE = 10.0, 1.0


def row(name: str, path: Path) -> dict[str, Any]:
    """The grip in the file `path`, at the worst of its angles; mm."""
    grip = load_grip(path)
    if grip.robot:  # of a package, as the scene of its name has it
        options = load_experiment([f"scene=hand/{name}"]).need("scene").options
        assert isinstance(options, HandScene.Options)
    else:
        options = HandScene.Options(**asdict(grip.measures), tool=grip.tool)
    scene = HandScene(options)
    every = [grip.held(scene, k, SECONDS, SETTLE) for k in range(len(grip.angles))]
    return {
        "grip": name,
        "when": datetime.date.today().isoformat(),
        "tool": grip.tool,
        "hand": asdict(grip.measures),
        "style": written(grip.style),
        "seconds": SECONDS,
        "angles": grip.angles.tolist(),
        "fell": sum(held.fell is not None for held in every),
        "slip": 1e3 * float(np.max([held.drift for held in every])),
        "depth": 1e3 * max(held.depth for held in every),
        "links": sorted(frozenset.union(*(held.links for held in every))),
    }


@torch.no_grad()
def in_warp(device: str, worlds: int, impratio: float) -> dict[str, Any]:
    """The standard grip in `worlds` of MuJoCo Warp, parallel; mm. Depth is of the first world, by MuJoCo's collisions."""
    experiment = load_experiment([
        "experiment=chopsticks/open_close_gpu", f"device={device}", f"num_worlds={worlds}", "initial_states.amplitude=[0,0]",
        f"scene.contact.impratio={impratio}", "scene.contact.iterations=20", "scene.contact.ls_iterations=20",
    ])  # fmt: skip
    built = build_environment(experiment, num_worlds=worlds, episode_seconds=2 * SECONDS)
    environment, scene = built.environment, built.context.scene
    assert isinstance(scene, HandScene)
    try:
        environment.reset(0, "grips")
        still = torch.zeros(worlds, environment.action_size, device=device)
        places, frames, fell = [], [], torch.zeros(worlds, dtype=torch.bool, device=device)
        for step in range(round(100 * SECONDS)):
            fell |= environment.advance(still).ended
            frames.append(environment.table["qpos"][0].double().cpu().numpy())
            if step >= 100 * SETTLE:
                places.append(environment.table["stick_state"][..., :3].clone())
    finally:
        environment.close()
    drift = torch.stack(places) - places[0]
    return {
        "grip": "standard", "when": datetime.date.today().isoformat(), "simulator": "mujoco_warp",
        "device": torch.cuda.get_device_name() if device == "cuda" else device, "worlds": worlds, "impratio": impratio,
        "seconds": SECONDS, "fell": int(fell.sum()),
        "slip": 1e3 * float(torch.linalg.vector_norm(drift, dim=-1).max()),
        "depth": measured(scene, np.array(frames), 0.01)["fingers"],
    }  # fmt: skip


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--device", help="of MuJoCo Warp: cuda, or cpu to try")
    parser.add_argument("--worlds", type=int, default=1024)
    parser.add_argument("--impratio", type=float, default=100.0)
    parser.add_argument(
        "--only", nargs="+", metavar="GRIP", help="measure these anew and leave the others"
    )
    given = parser.parse_args()
    if given.device is not None:
        line = json.dumps(in_warp(given.device, given.worlds, given.impratio)) + "\n"
        with WARP.open("a", encoding="utf-8") as file:
            file.write(line)
        print(line, end="")
        return
    registry = load().registry
    rows = {r["grip"]: r for r in map(json.loads, RESULTS.read_text().splitlines())}
    for one in given.only or registry.names("grip"):
        if not load_grip(registry.find("grip", one).factory()).holds:
            continue
        rows[one] = row(one, registry.find("grip", one).factory())
        print(json.dumps(rows[one]), flush=True)
    lines = [json.dumps(rows[name]) + "\n" for name in sorted(rows)]
    RESULTS.write_text("".join(lines), encoding="utf-8")


if __name__ == "__main__":
    main()
