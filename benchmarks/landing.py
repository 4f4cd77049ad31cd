"""Why episodes that begin in a flip's landing fail: the packaged policy from the clip's states, from its own, and from halves of both.

``UNDERSTUDY_DATA=… python benchmarks/landing.py`` plays ``spacetime/backflip`` from its clip's start, keeps the states in which it
passes each phase (its own), and lets it go on from these, from the clip's, and from the clip's with one thing of its own: heights and
turn of the root, the joints' angles, the root's velocity, its turning, or the joints' rates. It writes
``docs/benchmarks/landing.jsonl``: by variant and phase the share that stays within the bounds for two seconds.
"""

from __future__ import annotations

import argparse
import datetime
import json
from pathlib import Path

import torch
from torch import Tensor

from understudy.random import WorldStreams
from understudy.setup.building import build_environment
from understudy.task import InitialStates
from understudy_characters.initial_states import EPISODE_FIELDS, reference_states
from understudy_characters.scene import CharacterScene, reference_motion
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "landing.jsonl"
FROM, TO, APART = 0.9, 1.7, 1 / 30  # s
EACH, SECONDS = 8, 2.0


class Given(InitialStates):
    """States that are given, one a world."""

    episode_fields = EPISODE_FIELDS

    def __init__(self) -> None:
        self.states: dict[str, Tensor] = {}

    def sample(self, streams: WorldStreams, **fields: Tensor) -> dict[str, Tensor]:
        return {name: value.clone() for name, value in self.states.items()}


#: Which numbers of the state are the policy's own: of qpos, of qvel.
ROOT, TRAVEL, TURN = slice(2, 7), slice(0, 3), slice(3, 6)
VARIANTS: dict[str, tuple[list[slice], list[slice]]] = {
    "clip": ([], []),
    "own root": ([ROOT], []),
    "own joints": ([slice(7, None)], []),
    "own velocity of the root": ([], [TRAVEL]),
    "own turning of the root": ([], [TURN]),
    "own rates of the joints": ([], [slice(6, None)]),
    "own pose": ([slice(2, None)], []),
    "own velocities": ([], [slice(0, None)]),
    "own": ([slice(2, None)], [slice(0, None)]),
}


@torch.no_grad()
def main(name: str) -> None:
    torch.manual_seed(0)
    skill = open_skill(name)
    count = round((TO - FROM) / APART) + 1
    built = build_environment(
        skill.experiment, num_worlds=EACH * count, episode_seconds=60.0, evaluating=True
    )
    environment, reference = built.environment, reference_motion(built.context)
    model = built.context.need_scene(CharacterScene, "this benchmark").model
    policy = build_policy(skill.experiment, built.context)
    skill.give(policy)
    given = Given()
    environment.parts.initial_states = given
    number = environment.num_worlds

    def begun(states: dict[str, Tensor]) -> dict[str, Tensor]:
        given.states = states
        return environment.reset(0, "landing")

    # the policy's own states, from the clip's first tenth of a second on
    began = 0.1 * torch.rand(number)
    observations = begun(reference_states(reference, began))
    times = (FROM + APART * torch.arange(count)).repeat_interleave(EACH)
    own = {key: torch.zeros(number, n) for key, n in (("qpos", model.nq), ("qvel", model.nv))}
    lost = torch.zeros(number, dtype=torch.bool)
    passed, at = torch.zeros(number, dtype=torch.bool), torch.zeros(number)
    while not bool((passed | lost).all()):
        step = environment.step(policy.distribution(observations).mode())
        observations = step.observations
        lost |= step.failed & ~passed
        time = environment.table["motion_start"] + environment.table["episode_time"]
        now = ~passed & ~lost & (time >= times)
        for key, value in own.items():
            value[now] = environment.table[key][now]
        at[now] = time[now]
        passed |= now
    print(f"own states: {int(passed.sum())} of {number}, {int(lost.sum())} lost before", flush=True)
    at = torch.where(passed, at, times)
    clip = reference_states(reference, at)
    speed = {k: v["qvel"][:, 2] for k, v in (("clip", clip), ("own", own))}
    lines = []
    for variant, (places, rates) in VARIANTS.items():
        state = {key: value.clone() for key, value in clip.items()}
        for key, parts in (("qpos", places), ("qvel", rates)):
            for part in parts:
                state[key][:, part] = own[key][:, part]
        observations = begun(state)
        failed, over = torch.zeros(number, dtype=torch.bool), torch.zeros(number, dtype=torch.bool)
        when = torch.full((number,), torch.nan)
        for tick in range(round(SECONDS / environment.control_dt)):
            step = environment.step(policy.distribution(observations).mode())
            observations = step.observations
            first = step.failed & ~over
            when[first] = (tick + 1) * environment.control_dt
            failed |= first
            over |= step.ended
        good = (~failed & passed).view(count, EACH).float()
        counted = passed.view(count, EACH).float().sum(1).clamp(min=1)
        shares = good.sum(1) / counted
        row = {
            "skill": name, "variant": variant, "when": datetime.date.today().isoformat(),
            "episodes": int(passed.sum()), "within": float(good.sum() / passed.sum()),
            "fails_after_s": float(when.nanmedian()) if bool(failed.any()) else None,
            "times_s": [round(FROM + i * APART, 3) for i in range(count)],
            "by_time": [round(float(share), 3) for share in shares],
        }  # fmt: skip
        if variant in speed:
            row["rise_m_s"] = [round(float(v), 2) for v in speed[variant].view(count, EACH).mean(1)]
        lines.append(json.dumps(row))
        print(lines[-1], flush=True)
    environment.close()
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--skill", default="spacetime/backflip")
    main(parser.parse_args().skill)
