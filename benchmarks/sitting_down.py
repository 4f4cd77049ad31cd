"""How sitters sit down, beside whether they do: falls, slides, squats, and where they land.

``python benchmarks/sitting_down.py SITTER …`` judges skills, packed ones and runs of `sitting/sit` or `sitting/meta`, on the same unseen
starts, by the measures that the task has now, also those that were trained before it had them; ``targets`` is no skill but the
clip's own servo targets, played blindly, ``nothing`` the mode of a policy that has learned nothing: the middle of the clip's poses. ``--note sit`` gives the rows a name and adds them to
``docs/benchmarks/sitting/manner.jsonl``. Those there have ``--words initial_states.span=[0,0] initial_states.metres=0.05
initial_states.degrees=15``: the clip's first frame, the chair up to 5 cm along each axis and 15° off.
"""

from __future__ import annotations

import argparse
import datetime
import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from rows import append
from torch import Tensor

from understudy.setup.composition import load_experiment
from understudy_reinforcement.evaluator import Evaluator
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "sitting" / "manner.jsonl"
TARGETS = "targets"
NOTHING = "nothing"
MACHINE = "MuJoCo on a CPU core"
DRAW = "sitting down"  # of the starts, which no training uses


def manner(task: str) -> list[str]:
    """Overrides that give a configuration what the task measures now."""
    now = load_experiment([f"task={task}"]).effective()
    found = {"fields.manner": now["fields"]["manner"], "memory.descent": now["memory"]["descent"]}
    found |= {f"measure.{name}": value for name, value in now["measure"].items()}
    return [f"{key}={_flow(value)}" for key, value in found.items()]


def _flow(value: Any) -> str:
    """In the grammar of overrides."""
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{k}: {_flow(v)}" for k, v in value.items()) + "}"
    return "null" if value is None else str(value)


class _Blindly:
    """A policy that gives the servos the clip's targets, or with `told` false does nothing."""

    def __init__(self, evaluator: Evaluator, told: bool) -> None:
        self._told = told
        self._environment = evaluator.built.environment
        actuation: Any = self._environment.parts.actuation.part
        self._nothing = self._environment.action * 0.0
        self._middle = actuation.control(self._nothing)
        self._unit = actuation.control(self._nothing + 1.0) - self._middle

    def distribution(self, observations: Mapping[str, Tensor]) -> _Blindly:
        return self

    def mode(self) -> Tensor:
        if not self._told:
            return self._nothing
        return (self._environment.table["reference_joint_targets"] - self._middle) / self._unit


def row(sitter: str, episodes: int, note: str, words: list[str], machine: str) -> dict[str, Any]:
    """`sitter` on so many unseen starts; `words` are overrides besides, `machine` is named with it."""
    words = [*words, f"evaluation.episodes={episodes}"]
    seed = None
    if sitter in (TARGETS, NOTHING):
        experiment, samples = load_experiment(["experiment=sitting/sit", *words]), 0
        evaluator = Evaluator(experiment)
        policy: Any = _Blindly(evaluator, sitter == TARGETS)
    else:
        config = open_skill(sitter).card["config"]
        task, seed = str(config["task"]), config.get("seed")
        skill = open_skill(sitter, [*manner(task), *words])
        samples, evaluator = skill.samples, Evaluator(skill.experiment)
        policy = build_policy(skill.experiment, evaluator.built.context)
        skill.give(policy)
    found = evaluator.run(policy, DRAW, episodes)
    evaluator.close()
    return {
        "sitter": note or sitter,
        "when": datetime.date.today().isoformat(),
        "machine": machine,
        "episodes": episodes,
        "samples": samples,
        "seed": seed,
        "success_rate": found.success_rate,
        "measures": {name: measured.mean for name, measured in found.measures.items()},
    }


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sitters", nargs="+", help=f"skills, files, runs, {TARGETS} or {NOTHING}")
    parser.add_argument("--episodes", type=int, default=128)
    parser.add_argument("--note", default="", help="keep the rows, under this name")
    parser.add_argument("--words", nargs="*", default=[], help="overrides: KEY=VALUE")
    parser.add_argument("--machine", default=MACHINE, help="which trained and judged")
    given = parser.parse_args()
    for sitter in given.sitters:
        found = row(sitter, given.episodes, given.note, given.words, given.machine)
        print(json.dumps(found), flush=True)
        if given.note:
            append(RESULTS, found)


if __name__ == "__main__":
    main()
