"""Leads arms from where the shirt's second subtask ended into the sleeve, without forces, and keeps states on the way.

``python benchmarks/dressing_way.py BANK OUT`` takes states of a bank, as ``job=harvest`` leaves of ``dressing/shirt_tuck``. The
right hand lowers the hem, then the left elbow goes up before the chest while its fingertip goes to the middle of the sleeve's
entrance and through it; the cloth is simulated, and nothing limits torques. It writes to OUT the banks ``low`` (the hem on its
way down), ``half`` and ``near`` (the hand on its way, and 14 % in), those less than `TORN` and through no cloth, for the third
subtask's trainings to begin in, and appends to ``docs/benchmarks/dressing_way.jsonl`` how many came into the sleeve.
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path
from typing import Any

import mujoco
import numpy as np
import torch
from scipy.optimize import least_squares

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_cloth.mesh import face_areas
from understudy_dressing.person import limb
from understudy_dressing.shirt import Moves, ShirtScene
from understudy_dressing.state import centre_and_normal, pierces, progress
from understudy_skills import bank

RECORD = Path(__file__).resolve().parents[1] / "docs" / "benchmarks" / "dressing_way.jsonl"
#: Steps of 10 ms in which the hem comes down, and in all; a state is looked at in each so many.
LOWERS, STEPS, EVERY = 80, 300, 10
#: m, a step; where the elbow goes, m, and what that weighs beside the fingertip.
_SPEED, _ELBOW, _WEIGHT = 0.005, (0.28, 0.09, -0.08), 0.7
#: m, beyond the entrance: where the fingertip goes.
_BEYOND = 0.12
#: Area ratio of states that are not kept; progress of those that are in, and to which they are kept.
TORN, IN, ENOUGH = 2.6, 0.02, 0.14
_SIDE = "left"


class Led(Moves):
    """A shirt on a person whose left arm is led into its sleeve."""

    def __init__(self, shirt: ShirtScene, pose: np.ndarray, cloth: np.ndarray) -> None:
        super().__init__(shirt, pose, cloth)
        self._shirt = shirt
        self._entrance = torch.tensor(shirt.sleeve(_SIDE)["entrance"].copy())
        self._free = [*range(3), *self._arm(_SIDE)]
        limited = self._body.jnt_limited[self._free].astype(bool)
        ranges = self._body.jnt_range[self._free]
        self._low, self._high = (np.where(limited, ranges[:, k], s * 2.2) for k, s in enumerate((-1, 1)))  # fmt: skip

    def bones(self) -> np.ndarray:
        """(6, 3) m, as :func:`limb`."""
        return np.array([
            self._data.body(name).xpos + self._data.body(name).xmat.reshape(3, 3) @ np.array(at)
            for name, at in limb(_SIDE)
        ])  # fmt: skip

    def state(self) -> tuple[np.ndarray, np.ndarray, float, float, bool]:
        """Pose (22,) rad, vertices (V, 3) m, progress, area ratio, whether the arm goes through the cloth."""
        pose, x = self.found()
        self._place(pose)
        bones, cloth = torch.tensor(self.bones())[None], torch.tensor(x)[None]
        ratio = (face_areas(x[self._shirt.faces]) / face_areas(self._shirt.corners)).max()
        through = pierces(bones, cloth[:, torch.tensor(self._shirt.faces)])
        return pose.copy(), x, float(progress(bones, cloth[:, self._entrance])[1]), float(ratio), bool(through)  # fmt: skip

    def lower(self, end: np.ndarray, share: float, begin: np.ndarray) -> None:
        """Trunk and right arm go towards those of the pose `end`, from those of `begin`."""
        pose, left = self._pose.copy(), self._arm(_SIDE)
        others = [i for i in range(len(pose)) if i not in left]
        pose[others] = begin[others] + share * share * (3 - 2 * share) * (end - begin)[others]
        self._go(pose)

    def approach(self) -> None:
        """Fingertip and elbow go on by a step."""
        pose, x = self.found()
        self._place(pose)
        bones = self.bones()
        cloth = torch.tensor(x[self._entrance])[None]
        centre, normal = (one[0].numpy() for one in centre_and_normal(cloth))
        inside = float(progress(torch.tensor(bones)[None], cloth)[1]) > 0
        tip = _towards(bones[0], bones[0] + normal if inside else centre + _BEYOND * normal)
        elbow = _towards(bones[3], np.array(_ELBOW))
        begin = pose[self._free].copy()

        def off(hinges: np.ndarray) -> np.ndarray:
            pose[self._free] = hinges
            self._place(pose)
            at = self.bones()
            mujoco.mj_collision(self._body, self._data)
            near = sum(max(0.0, 0.003 - contact.dist) for contact in self._data.contact)
            return np.concatenate([at[0] - tip, _WEIGHT * (at[3] - elbow), 0.03 * (hinges - begin), [3.0 * near]])  # fmt: skip

        inner = np.clip(begin, self._low + 1e-3, self._high - 1e-3)
        pose[self._free] = least_squares(
            off, inner, bounds=(self._low, self._high), diff_step=1e-4, max_nfev=6
        ).x
        self._go(pose)

    def _go(self, pose: np.ndarray) -> None:
        self._pose = pose
        self._step(pose, (True, False))


def _towards(begin: np.ndarray, end: np.ndarray) -> np.ndarray:
    way = end - begin
    return begin + way * min(1.0, _SPEED / float(np.linalg.norm(way)))


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("bank")
    parser.add_argument("out", type=Path)
    parser.add_argument("--count", type=int, default=14, help="states, evenly of the bank")
    parser.add_argument("--edge", type=float, default=0.03)
    options = parser.parse_args()
    states = bank.load(options.bank)
    shirt = ShirtScene(ShirtScene.Options(edge=options.edge))
    lowered = shirt.settled("in_sleeve", _SIDE)[0]
    kept: dict[str, list[tuple[np.ndarray, np.ndarray]]] = {"low": [], "half": [], "near": []}
    best = []
    for row in np.linspace(0, len(states["qpos"]) - 1, options.count).round().astype(int):
        begin = states["qpos"][row, :22].double().numpy()
        led = Led(shirt, begin, states["cloth_position"][row].double().numpy())
        found: list[Any] = []
        for step in range(1, STEPS + 1):
            if step <= LOWERS:
                led.lower(lowered, step / LOWERS, begin)
            else:
                led.approach()
            if step % EVERY == 0:
                found.append(led.state())
                if found[-1][4] or found[-1][2] > ENOUGH:
                    break
        whole = [one for one in found if not one[4]]
        best.append(max(one[2] for one in whole))
        print(int(row), round(best[-1], 3), flush=True)
        lowers = LOWERS // EVERY
        fine = [one[:2] if one[3] < TORN else None for one in whole]
        kept["low"] += [one for one in fine[1:lowers] if one]
        if best[-1] > IN:
            middle = (lowers + len(fine)) // 2
            kept["half"] += [one for one in fine[lowers:middle] if one]
            kept["near"] += [one for one in fine[middle:] if one]
    words = ["experiment=dressing/shirt_sleeve", "device=cpu", "simulators.person.name=mujoco", f"scenes.cloth.edge={options.edge}", "num_worlds=1"]  # fmt: skip
    built = build_environment(load_experiment(words))
    rest = states["qpos"].shape[1] - 22
    for name, ones in kept.items():
        if not ones:
            continue
        pose, cloth = (torch.tensor(np.stack(them), dtype=torch.float32) for them in zip(*ones, strict=True))  # fmt: skip
        at = {"qpos": torch.nn.functional.pad(pose, (0, rest)), "cloth_position": cloth}
        still = {"qvel": torch.zeros_like(at["qpos"]), "cloth_velocity": torch.zeros_like(cloth)}
        (options.out / name).mkdir(parents=True, exist_ok=True)
        bank.save(options.out / name / bank.NAME, {**at, **still}, {"led": "dressing_way"}, built.scene)  # fmt: skip
    built.environment.close()
    record = {
        "when": datetime.date.today().isoformat(), "machine": "one busy CPU core", "edge": options.edge, "from": options.count,
        "into_the_sleeve": sum(one > IN for one in best), "progress": best, "states": {name: len(ones) for name, ones in kept.items()},
    }  # fmt: skip
    print(record)
    with RECORD.open("a") as file:
        file.write(json.dumps(record) + "\n")


if __name__ == "__main__":
    main()
