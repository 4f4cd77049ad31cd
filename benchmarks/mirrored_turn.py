"""The left turn that ships: the right one's mirror image.

``python benchmarks/mirrored_turn.py FOLDER`` writes ``FOLDER/turn_left`` as a packed skill: `sitting/turn_right` with left and right
exchanged in what it sees and does, exactly, and nothing trained. The figure, its clips and their tasks are mirror images of each
other. Why: the left turn that was learned by itself depended on the time step (docs/benchmarks/README.md).
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from understudy.setup.building import build_environment
from understudy_characters.scene import CharacterScene
from understudy_skills.pack import pack
from understudy_skills.skill import Skill, open_skill

LEFT, RIGHT = "sitting/turn_left", "sitting/turn_right"


def mirrored_name(name: str) -> str:
    """Of a joint, foot or column: what is at the other side."""
    exchanged = {"left_": "right_", "right_": "left_"}
    for side, other in exchanged.items():
        if side in name:
            return name.replace(side, other)
    return name


def image(names: Sequence[str], turned: Sequence[bool]) -> tuple[Tensor, Tensor]:
    """Where the mirror image of each of `names` is, and its sign, -1 where `turned`."""
    at = {name: k for k, name in enumerate(names)}
    where = torch.tensor([at[mirrored_name(name)] for name in names])
    return where, torch.tensor([-1.0 if one else 1.0 for one in turned])


def mirror(skill: Skill) -> dict[str, Tensor]:
    """The tensors of the policy that does left what `skill`, a turn, does right."""
    built = build_environment(skill.experiment, num_worlds=1)
    try:
        scene = built.scene
        assert isinstance(scene, CharacterScene)
        columns = list(built.environment.parts.encoders["state"].part.columns)
        servos = [scene.model.actuator(k).name for k in range(scene.model.nu)]
    finally:
        built.environment.close()
    across = ("_x", "_z", "/left", "/roll")  # what a mirror in the x-z plane turns round
    seen, sign = image(columns, [name.endswith(across) for name in columns])
    done, way = image(servos, [name.endswith(across) for name in servos])
    given = skill.policy
    found = dict(given)
    found["normaliser.mean"] = sign * given["normaliser.mean"][seen]
    found["normaliser.variance"] = given["normaliser.variance"][seen]
    found["actor.0.weight"] = sign * given["actor.0.weight"][:, seen]
    found["actor.4.weight"] = way[:, None] * given["actor.4.weight"][done]
    found["actor.4.bias"] = way * given["actor.4.bias"][done]
    found["log_deviation"] = given["log_deviation"][done]
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("folder", type=Path, help="where the packed skill goes")
    parser.add_argument("--evaluation", type=Path, help="what it was judged by (evaluation.json)")
    given = parser.parse_args()
    right, left = open_skill(RIGHT), open_skill(LEFT)
    config = {**right.card["config"], "motion": left.card["config"]["motion"]}
    words = [
        f"experiment={LEFT}" if one == f"experiment={RIGHT}" else one
        for one in right.card["overrides"]
    ]
    motion = {**right.card["sources"], "motion": left.card["sources"]["motion"], "mirror": RIGHT}
    card = {**right.card, "config": config, "overrides": words, "sources": motion}
    made = replace(left, policy=mirror(right), samples=right.samples, card=card)
    judged = card["evaluation"]
    if given.evaluation is not None:
        judged = json.loads(given.evaluation.read_text(encoding="utf-8"))
    pack(made, given.folder / "turn_left", judged)


if __name__ == "__main__":
    main()
