"""Whether the packaged grips hold without a policy.

``python benchmarks/grips.py`` holds each for ten seconds at each of its angles under fixed targets, measures how far the tool slips in
the palm and how deep anything is in it, and writes ``docs/benchmarks/grips.jsonl``, from which ``make figures`` writes a table on
the page of chopsticks. ``--device cuda`` holds the standard one in MuJoCo Warp instead, parallel, in many worlds, and appends a row to
``docs/benchmarks/grips_warp.jsonl``. ``--searched FOLDER`` holds the grips that a search over styles found (``STYLE.json``, of
``benchmarks/styles.py --grips``) in its place, into ``docs/benchmarks/grips_searched.jsonl``, with what its three motions score under fixed
targets and how far the fingers are in each other, which the hand's model allows. ``--apart FOLDER`` finds a grip of each of these styles
whose fingers keep 0.5 mm from one another, at the same places or, where there is none, at places that are drawn about them, into
``docs/benchmarks/grips_apart.jsonl``; ``--keep FOLDER`` keeps them there. ``--touching`` holds the packaged ones with fingers that touch one
another (``scene.self_collision``) into ``docs/benchmarks/grips_touching.jsonl``, with what that costs. ``--draw PICTURE.png GRIP …`` draws
the grips of files, or packaged ones by name, in rows of close-ups with the forces on the tool (thesis, figure 5.23), and measures nothing.
"""

from __future__ import annotations

import argparse
import datetime
import json
import tempfile
import time
from collections.abc import Iterator
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from held import measured

from understudy.errors import ConfigError
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import load
from understudy_chopsticks.gallery import close_ups
from understudy_gripping.finding import find_grip, search_grip
from understudy_gripping.grip import Grip, load_grip
from understudy_gripping.hold import hold, nearest_fingers, placed
from understudy_gripping.holding import holding
from understudy_gripping.styles import written
from understudy_hand.scene import HandScene
from understudy_hand.table import ARM_POSE
from understudy_report.pictures import png

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "grips.jsonl"
SEARCHED = RESULTS.with_name("grips_searched.jsonl")
APART = RESULTS.with_name("grips_apart.jsonl")
WARP = RESULTS.with_name("grips_warp.jsonl")
TOUCHING = RESULTS.with_name("grips_touching.jsonl")
#: m that fingers keep apart. How many places are drawn, and with which seed: none; about those that were found; about a first guess.
CLEARANCE, ROUNDS = 5e-4, ((0, 0), (48, 0), (96, 1))
SECONDS, SETTLE = 10.0, 1.0


def row(name: str, path: Path, self_collision: bool = False) -> dict[str, Any]:
    """The grip in the file `path`, at the worst of its angles; mm. With `self_collision` fingers touch one another."""
    grip = load_grip(path)
    if grip.robot:  # of a package, as the scene of its name has it
        options = load_experiment([f"scene=hand/{name}"]).need("scene").options
        assert isinstance(options, HandScene.Options)
    else:
        options = HandScene.Options(**asdict(grip.measures), tool=grip.tool)
    scene = HandScene(replace(options, self_collision=self_collision))
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
def still(path: Path) -> float:
    """The score of the grip under fixed targets in the three motions of the search, in MuJoCo."""
    experiment = load_experiment([
        "search=chopsticks/grips", "outer_loop=null", "executor=null", f"grip.file={path}", "device=cpu", "simulator=mujoco", "num_worlds=48",
    ])  # fmt: skip
    environment = build_environment(experiment, num_worlds=48).environment
    try:
        environment.reset(0, "grips")
        rest = torch.zeros(48, environment.action_size)
        rewards = [environment.advance(rest).rewards.mean() for _ in range(100)]
    finally:
        environment.close()
    return float(torch.stack(rewards).mean())


def overlap(grip: Grip) -> tuple[float, list[str]]:
    """mm, and which two links: how far two fingers are in each other at the most, held parallel and closed; below 0 they are apart."""
    scene = HandScene(HandScene.Options(**asdict(grip.measures), tool=grip.tool))
    nearest = []
    for row in (0, len(grip.angles) - 1):
        data = placed(scene, np.array(ARM_POSE), grip.poses[row], grip.upper[row], grip.lower)
        hold(scene, data, np.array([*ARM_POSE, *grip.targets[row]]))
        nearest.append(nearest_fingers(scene, data))
    distance, links = min(nearest)
    return -1e3 * distance, list(links)


def kept_apart(path: Path, folder: Path) -> dict[str, Any]:
    """A grip of the style and, if there is one, the places of that in `path`, whose fingers keep apart; saved in `folder`."""
    before = load_grip(path)
    scene, found, why = HandScene(HandScene.Options(**asdict(before.measures))), None, ""
    drawn = 0
    for tries, seed in ROUNDS:
        drawn += tries
        try:
            if tries:
                middle = before.places if seed == 0 else holding("sticks").first_guess(before.style)
                found = search_grip(
                    scene, before.style, middle, tries, seed, finger_clearance=CLEARANCE
                )
            else:
                found = find_grip(scene, before.style, before.places, finger_clearance=CLEARANCE)
            break
        except ConfigError as error:
            why = why or str(error)
    about = {"clearance": 1e3 * CLEARANCE, "tries": drawn, "at_the_same_places": why}
    if found is None:
        return {"grip": path.stem, "when": datetime.date.today().isoformat(), **about, "holds": 0}
    found.save(file := folder / path.name)
    deep, links = overlap(found)
    kept = _touching(path.stem, file)
    one = {**row(path.stem, file), **about, **kept, "places": found.places}
    return {
        **one,
        "holds": int(not one["fell"]),
        "still": still(file),
        "overlap": deep,
        "overlapping": links,
    }


def touching() -> Iterator[dict[str, Any]]:
    """Packaged grips, and the standard one found anew with fingers that keep apart, with fingers that touch one another beside those
    that do not; of the standard one what that costs."""
    registry = load().registry
    paths = {name: registry.find("grip", name).factory() for name in registry.names("grip")}
    grip = load_grip(paths["standard"])
    with tempfile.TemporaryDirectory() as folder:
        paths["standard, apart"] = Path(folder) / "grip.json"
        scene = HandScene(HandScene.Options())
        anew = find_grip(scene, grip.style, grip.places, finger_clearance=CLEARANCE)
        anew.save(paths["standard, apart"])
        for name, path in paths.items():
            if not (one := load_grip(path)).holds or one.robot:
                continue
            deep, links = overlap(one)
            found = {**row(name, path), **_touching(name, path)}
            yield {**found, "overlap": deep, "overlapping": links}
    rates: dict[bool, list[float]] = {False: [], True: []}
    for _ in range(5):
        for on, of in rates.items():
            scene = HandScene(HandScene.Options(self_collision=on))
            data = placed(scene, np.array(ARM_POSE), grip.poses[0], grip.upper[0], grip.lower)
            data.ctrl[:] = [*ARM_POSE, *grip.targets[0]]
            mujoco.mj_step(scene.model, data, 100)
            begun = time.process_time()
            mujoco.mj_step(scene.model, data, 1500)
            of.append(1500 / (time.process_time() - begun))
    apart, met = (float(np.median(rates[on])) for on in (False, True))
    when = datetime.date.today().isoformat()
    yield {"grip": "standard, steps a second of a core", "when": when, "free": apart, "touching": met, "ratio": apart / met}  # fmt: skip


def _touching(name: str, path: Path) -> dict[str, Any]:
    found = row(name, path, self_collision=True)
    return {f"touching_{key}": found[key] for key in ("fell", "slip", "depth")}


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
    parser.add_argument("--searched", type=Path, metavar="FOLDER", help="of grips that were found")
    parser.add_argument("--touching", action="store_true", help="with fingers that touch one another")  # fmt: skip
    parser.add_argument("--apart", type=Path, metavar="FOLDER", help="of grips that were found")
    parser.add_argument("--keep", type=Path, metavar="FOLDER", help="for those whose fingers keep apart")  # fmt: skip
    parser.add_argument("--draw", nargs="+", metavar=("PICTURE", "GRIP"), help="files of grips, or names of packaged ones")  # fmt: skip
    given = parser.parse_args()
    if given.draw is not None:
        packaged = load().registry
        picture, *grips = given.draw
        paths = [
            Path(g) if g.endswith(".json") else packaged.find("grip", g).factory() for g in grips
        ]
        drawn = [np.concatenate(close_ups(load_grip(path)), axis=1) for path in paths]
        Path(picture).write_bytes(png(np.concatenate(drawn)))
        return
    if given.device is not None:
        line = json.dumps(in_warp(given.device, given.worlds, given.impratio)) + "\n"
        with WARP.open("a", encoding="utf-8") as file:
            file.write(line)
        print(line, end="")
        return
    if given.searched is not None:
        known = SEARCHED.read_text().splitlines() if given.only and SEARCHED.exists() else []
        rows = {r["grip"]: r for r in map(json.loads, known)}
        for path in sorted(given.searched.glob("*.json")):
            if given.only and path.stem not in given.only:
                continue
            deep, links = overlap(load_grip(path))
            more = {"still": still(path), "overlap": deep, "overlapping": links}
            rows[path.stem] = {**row(path.stem, path), **more}
            print(json.dumps(rows[path.stem]), flush=True)
        lines = [json.dumps(rows[name]) + "\n" for name in sorted(rows)]
        SEARCHED.write_text("".join(lines), encoding="utf-8")
        return
    if given.touching:
        lines = []
        for one in touching():
            lines.append(json.dumps(one) + "\n")
            print(lines[-1], end="", flush=True)
        TOUCHING.write_text("".join(lines), encoding="utf-8")
        return
    if given.apart is not None:
        with tempfile.TemporaryDirectory() as other:
            folder = given.keep or Path(other)
            folder.mkdir(parents=True, exist_ok=True)
            known = APART.read_text().splitlines() if given.only and APART.exists() else []
            rows = {r["grip"]: r for r in map(json.loads, known)}
            for path in sorted(given.apart.glob("*.json")):
                if not given.only or path.stem in given.only:
                    rows[path.stem] = kept_apart(path, folder)
                    print(json.dumps(rows[path.stem]), flush=True)
        lines = [json.dumps(rows[name]) + "\n" for name in sorted(rows)]
        APART.write_text("".join(lines), encoding="utf-8")
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
