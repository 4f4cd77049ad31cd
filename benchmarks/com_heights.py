"""How high the centre of mass is beside its bound, phase by phase (thesis, figure 3.6): packaged policies, 100 episodes each.

``UNDERSTUDY_DATA=… python benchmarks/com_heights.py`` plays each of `SKILLS` from any phase of its clip, by the policy's mode, for
`SECONDS`, and notes how high the centre of mass is over its reference's until it falls. A spread is between the 5th and the
95th percentile of that within a twentieth of the clip. Take-off and landing of the backflip are the 0.2 s before and after the clip's
longest time without the floor. It writes ``docs/benchmarks/com_heights.jsonl``.
"""

from __future__ import annotations

import datetime
import json
from pathlib import Path

import torch

from understudy.setup.building import build_environment
from understudy_characters.scene import reference_motion
from understudy_doctor.findings import intervals
from understudy_reinforcement.policy import build_policy
from understudy_skills.skill import open_skill

RESULTS = Path(__file__).parents[1] / "docs" / "benchmarks" / "com_heights.jsonl"
SKILLS = ("walk", "run", "backflip")
EPISODES, SECONDS, PARTS, NEAR = 100, 10.0, 20, 0.2
BOUND = 0.2  # m (section 3.5.1)
ALOFT = 0.02  # m of the reference's lowest link over the floor


def flight(clearances: torch.Tensor, duration: float) -> tuple[float, float]:
    """Begin and end of the longest time aloft, s, of the lowest link's clearance (T,) over a clip of `duration` s."""
    found = intervals((clearances > ALOFT).numpy(), close=1)
    first, last = max(found, key=lambda one: one[1] - one[0])
    return first * duration / len(clearances), (last + 1) * duration / len(clearances)


@torch.no_grad()
def played(name: str) -> list[dict[str, object]]:
    skill = open_skill(f"spacetime/{name}")
    built = build_environment(
        skill.experiment, num_worlds=EPISODES, episode_seconds=SECONDS, evaluating=True
    )
    environment, reference = built.environment, reference_motion(built.context)
    policy = build_policy(skill.experiment, built.context)
    skill.give(policy)
    observations = environment.reset(0, "com_heights")
    alive = torch.ones(EPISODES, dtype=torch.bool)
    phases, offs = [], []
    for _ in range(round(SECONDS / environment.control_dt)):
        observations = (
            step := environment.step(policy.distribution(observations).mode())
        ).observations
        alive &= ~step.failed
        table = environment.table
        phases.append(table["phase"][alive].clone())
        offs.append((table["com_position"] - table["reference_com_position"])[alive, 2].clone())
    environment.close()
    phase, off = torch.cat(phases), torch.cat(offs)

    def row(of: str, chosen: torch.Tensor) -> dict[str, object]:
        low, high = torch.quantile(off[chosen], torch.tensor([0.05, 0.95])).tolist()
        return {
            "of": of, "skill": f"spacetime/{name}", "when": datetime.date.today().isoformat(),
            "episodes": EPISODES, "samples": skill.samples, "lasted": int(alive.sum()),
            "within": float((off[chosen].abs() <= BOUND).float().mean()),
            "most_m": float(off[chosen].abs().max()), "spread_m": high - low,
        }  # fmt: skip

    parts = (phase * PARTS).long().clamp(0, PARTS - 1)
    whole = row(name, torch.ones_like(phase, dtype=torch.bool))
    spreads = [row("", parts == part)["spread_m"] for part in range(PARTS)]
    rows = [{**whole, "by_phase_m": spreads}]
    if name == "backflip":
        times = torch.arange(0.0, reference.duration, 0.01)
        lowest = reference.sample(times)["reference_link_clearances"].amin(1)
        begin, end = flight(lowest, reference.duration)
        time = phase * reference.duration
        rows.append(row("backflip, take-off", (time > begin - NEAR) & (time <= begin)))
        rows.append(row("backflip, landing", (time > end) & (time <= end + NEAR)))
    return rows


if __name__ == "__main__":
    lines = [json.dumps(one) for name in SKILLS for one in played(name)]
    RESULTS.write_text("\n".join(lines) + "\n", encoding="utf-8")
    print("\n".join(lines))
