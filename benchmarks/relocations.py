"""Relocations in a row: how many an object survives, and where failures begin (thesis, figure 5.21).

``python benchmarks/relocations.py --what "friction 1.0" initial_states.relocations=8 scene.object.friction=1.0`` plays the shipped
skill of relocation in MuJoCo on one core, each episode by a plan of its own that no training followed, and writes a row into
``docs/benchmarks/relocations.jsonl``. The row is written after every episode, and the same command goes on with it: what was under way
when it was cut is begun anew, so that quick failures would be counted too often if cuts were many.

``--another`` puts another object of table 5.2 on the table after each relocation, as the thesis' tasks of eight have it, of a skill whose
object is of any kind (``chopsticks/objects``); each is planned as it begins (``memory.again.onward=true``).

``--untrained EXPERIMENT`` follows the plans of an experiment without a policy: the targets are the plan's alone.
"""

from __future__ import annotations

import argparse
import datetime
import json
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import torch

from understudy.running.environment import Environment
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy_chopsticks.plan_bank import Bank
from understudy_chopsticks.relocate import Relocations
from understudy_reinforcement.evaluation import wilson_interval
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import open_skill
from understudy_tensors import rotations
from understudy_tool_planner.planner import CLOSING, DT
from understudy_tool_planner.tasks import random_table

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "relocations.jsonl"
SKILL = "chopsticks/relocate"
#: m from its plan, beyond which an object is on its way to be lost: what counts as placed, too.
OFF = 0.005
#: Of an experiment without a policy: whatever one does counts for nothing.
_UNTRAINED = (
    "simulator=mujoco",
    "device=cpu",
    "actuation.hand=0",
    "actuation.arm=0",
    "initial_states.refill=0",
)
PHASES = ("approach", "grasp", "carry", "release")


class Watched:
    """What happens to an object, until its episode ends."""

    def __init__(self, pressing: float) -> None:
        self._pressing = pressing  #: s
        self.placed = ""  #: 1 or 0, of each relocation that is over; at its end:
        self.away = list[float]()  #: mm from the goal
        self.slipped = list[float]()  #: mm of the lower stick in the palm
        self.kinds = ""  #: first letter of what was moved
        self.began = ""  #: phase in which it first was OFF its plan, in this relocation
        self._leg, self._held = -1, 0.0

    def see(
        self, table: Any, endings: dict[str, torch.Tensor], world: int, ended: torch.Tensor
    ) -> dict[str, Any] | None:
        """What is to be said of it once it has ended."""
        leg, held = int(table["planned_leg"][world]), bool(table["planned_held"][world])
        if leg != self._leg:
            self._leg, self._held, self.began = leg, 0.0, ""
        self._held += DT * held
        if float(table["object_distance"][world]) > OFF and not self.began:
            grasped = self._held > CLOSING + self._pressing
            self.began = PHASES[1 + grasped if held else 3 * (self._held > 0)]
        placed, missed = (bool(table[n][world]) for n in ("leg_placed", "leg_missed"))
        if (placed or missed) and len(self.placed) == leg:
            self.placed += "01"[placed]
            self.kinds += "scb"[int(table["object_shape"][world, :3].argmax())]
            self.away.append(round(1e3 * float(table["goal_distance"][world]), 2))
            self.slipped.append(round(1e3 * float(table["stick_distance"][world, 1]), 2))
        if not bool(ended[world]):
            return None
        fired = [name for name, of in endings.items() if bool(of[world])]
        if bool(table["given_up"][world]):
            fired = ["no plan"]
        again = int(table["replans"][world])
        return {
            "placed": self.placed, "kinds": self.kinds, "mm": self.away, "slip": self.slipped, "ended": fired[0] if fired else "time",
            "began": self.began, **({"replans": again} if again else {}),
        }  # fmt: skip


@torch.no_grad()
def episodes(
    name: str,
    words: list[str],
    begun: int,
    count: int,
    worlds: int,
    seconds: float,
    untrained: bool = False,
    another: bool = False,
    seed: int = 0,
) -> Iterator[dict[str, Any]]:
    """Those of the numbers from `begun` to `count`, as they end; as many side by side as there are `worlds`. `name` is
    a skill's, or of `untrained` worlds an experiment's; each relocation may move `another` object. Another `seed` has other
    plans."""
    worlds = min(worlds, count - begun)
    words = [*words, f"seed={seed + begun}", f"initial_states.plans={worlds}"]
    skill = None if untrained else open_skill(name, words)
    if skill is not None:
        experiment = skill.experiment
    else:
        experiment = load_experiment([f"experiment={name}", *_UNTRAINED, *words])
    built = build_environment(
        experiment, num_worlds=worlds, episode_seconds=seconds, evaluating=True
    )
    environment, initial = built.environment, built.environment.parts.initial_states
    assert isinstance(initial, Relocations)
    if another and not initial.bank.one_by_one:
        environment.close()
        raise SystemExit(
            "--another needs memory.again.onward=true: what is planned before is planned for the object that goes."
        )
    try:
        policy = build_policy(experiment, built.context)
        if skill is not None:
            skill.give(policy)
        objects = torch.Generator().manual_seed(begun)
        seen, table = environment.reset(begun, "relocations"), environment.table
        watched, begun = [Watched(initial.pressing) for _ in range(worlds)], begun + worlds
        while any(w is not None for w in watched):
            step = environment.advance(policy.distribution(seen).mode())
            seen, again = step.observations, torch.zeros(worlds, dtype=torch.bool)
            for world, one in enumerate(watched):
                if (
                    one is None
                    or (found := one.see(table, step.endings, world, step.ended)) is None
                ):
                    continue
                yield found
                watched[world] = None
                if begun < count:
                    watched[world], begun, again[world] = Watched(initial.pressing), begun + 1, True
                    initial.bank.replace(world)
            over = ((table["leg_placed"] > 0) | (table["leg_missed"] > 0)) & ~step.ended
            if another and bool(over.any()):
                _put_another(environment, initial.bank, over, objects)
            if bool(again.any()):
                seen = environment.begin(again)
    finally:
        environment.close()


def _put_another(
    environment: Environment, bank: Bank, worlds: torch.Tensor, generator: torch.Generator
) -> None:
    """In these `worlds` (N,) bool the object goes and another one lies elsewhere on the table: as in the release one is in play at a time."""
    simulator, forms, scene = environment.parts.simulator, bank.forms, bank.scene
    assert forms is not None
    joint = scene.model.joint("object")
    at, dof = int(joint.qposadr[0]), int(joint.dofadr[0])
    state = {name: simulator.read(name).clone() for name in simulator.state_fields}
    rows = environment.table["followed"].long()
    for world in worlds.nonzero()[:, 0].tolist():
        table = random_table(generator, count=1)
        bank.give(int(rows[world]), table.shapes[0])
        lies = torch.tensor([*table.places[0], table.shapes[0].height])
        turn = rotations.from_heading(torch.tensor(table.headings[0]))
        state["qpos"][world, at : at + 7] = torch.cat([lies, turn])
        state["qvel"][world, dof : dof + 6] = 0.0
    state |= forms.values(bank.kinds[rows], bank.sizes[rows])
    simulator.set_state(worlds, state)
    environment.refresh()


def summary(episodes: list[dict[str, Any]], relocations: int) -> dict[str, Any]:
    """By k, how many placed the first k relocations, their share and its interval; how the others ended."""
    count, why = len(episodes), {}
    curve, shares = list[list[int]](), list[tuple[float, list[float]]]()
    for k in range(1, relocations + 1):
        good = sum(e["placed"].startswith("1" * k) for e in episodes)
        curve.append([k, good])
        interval = [round(x, 3) for x in wilson_interval(good / count, count)]
        shares.append((good / count, interval))
    for episode in episodes:
        if episode["placed"] != "1" * relocations:
            name = f"{episode['ended']}, from the {episode['began'] or 'end'}"
            why[name] = why.get(name, 0) + 1
    return {
        "tasks": count,
        "in_a_row": curve,
        "shares": [round(share, 4) for share, _ in shares],
        "shares_95": [interval for _, interval in shares],
        "failures": dict(sorted(why.items())),
    }


def _named(given: argparse.Namespace) -> str:
    if given.untrained is not None:
        return f"none ({given.untrained})"
    return Path(given.skill).stem if given.skill.endswith(".json") else str(given.skill)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--what", required=True, help="name of the row")
    parser.add_argument("--skill", default=SKILL, help="that ships, a packed one, or a run")
    parser.add_argument("--untrained", metavar="EXPERIMENT", help="whose plans no policy follows")
    parser.add_argument("--another", action="store_true", help="object after each relocation")
    parser.add_argument("--episodes", type=int, default=50)
    parser.add_argument("--seed", type=int, default=0, help="of the plans")
    parser.add_argument("--worlds", type=int, default=16, help="episodes side by side")
    parser.add_argument("--seconds", type=float, default=32.0, help="of an episode, at most")
    parser.add_argument("--machine", default="one CPU core")
    parser.add_argument("--out", type=Path, default=RESULTS)
    given, words = parser.parse_known_args()
    torch.set_num_threads(1)
    lines = given.out.read_text().splitlines() if given.out.exists() else []
    rows = [json.loads(line) for line in lines]
    row = next((r for r in rows if r["what"] == given.what), None)
    if row is None:
        rows.append(row := {"what": given.what, "episodes": []})
    relocations = next(
        (int(w.split("=")[1]) for w in words if w.startswith("initial_states.relocations=")), 1
    )
    done, begun = len(row["episodes"]), time.process_time()
    spent = row.get("core_seconds", 0.0)
    for found in episodes(
        given.untrained or given.skill, words, done, given.episodes, given.worlds, given.seconds,
        given.untrained is not None, given.another, given.seed,
    ):  # fmt: skip
        row["episodes"].append(found)
        row |= {
            "when": datetime.date.today().isoformat(), "device": "cpu", "machine": given.machine,
            "skill": _named(given), "simulator": "mujoco", "overrides": words, **({"seed": given.seed} if given.seed else {}),
            "core_seconds": round(spent + time.process_time() - begun, 1),
            **summary(row["episodes"], relocations),
        }  # fmt: skip
        given.out.write_text("".join(json.dumps(r) + "\n" for r in rows), encoding="utf-8")
        print(json.dumps(found), flush=True)
    print(json.dumps({k: v for k, v in row.items() if k != "episodes"}))


if __name__ == "__main__":
    main()
