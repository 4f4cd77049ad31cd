"""How often the replay of one success succeeds from other starts, beside the policies themselves (section 9 of the dressing paper).

``python benchmarks/dressing_replay.py`` plays the kept policies of the shirt's first subtasks, each alone and both in one
episode, from as many unseen starts as there are `--worlds`, and with ``--only larger`` those of all seven on the larger shirt;
then the torques and grips of the first success, open loop, from the same starts: to its end, and with the last of them for
0.4 s more, in which the criterion may still come to hold. It appends a row for each to
``docs/benchmarks/dressing_replay.jsonl``. Words after ``--`` are overrides of every row, such as ``device=cuda``.
"""

from __future__ import annotations

import argparse
import datetime
from pathlib import Path

import torch
from rows import append
from torch import Tensor

from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment

KEPT = Path(__file__).resolve().parents[1] / "docs" / "benchmarks"
RECORD = KEPT / "dressing_replay.jsonl"
CPU = ("device=cpu", "simulators.person.name=mujoco")
COARSE = ("experiment=dressing/shirt", "scenes.cloth.edge=0.03", "scene.steps.cloth=10")
STAGES = {
    "grip": "{{run: {kept}/shirt_grip.json, until: {{field: gripped, at_least: 1.0}}, seconds: 4.0}}",
    "tuck": "{{run: {kept}/shirt_tuck.json, until: {{field: tucked, at_least: 1.0, lasting: 0.64}}, seconds: 4.0}}",
}
#: Control periods in a decision.
PERIODS = 4


def _played(subtasks: tuple[str, ...], *starts: str) -> tuple[str, ...]:
    stages = ", ".join(STAGES[one].format(kept=KEPT / "dressing") for one in subtasks)
    return (*COARSE, *starts, f"actuation.stages=[{stages}]")


#: Which subtasks in what they begin in; and the most decisions that they may take.
PLAYED = {
    "grip": (_played(("grip",)), 100),
    "tuck": (_played(("tuck",), "initial_states.worn=held"), 100),
    "both": (_played(("grip", "tuck")), 200),
    "larger": (("experiment=dressing/shirt_larger",), 975),
}
#: By default; the whole row takes an hour and more of a CPU core.
FIRST = ("grip", "tuck", "both")


def outcomes(
    words: list[str], worlds: int, decisions: int, replayed: Tensor | None = None
) -> tuple[Tensor, Tensor]:
    """The decision of each world's success, infinite where it failed or never came, (N,); and every world's controls
    (P, N, C) of all P control periods. With `replayed` (P, C) these are what every world is given, the last of them for longer."""
    environment = build_environment(
        load_experiment([*words, f"num_worlds={worlds}"]), evaluating=True
    ).environment
    actuation, controls = environment.parts.actuation.part, []
    own = actuation.control

    def control(action: Tensor, **fields: Tensor) -> Tensor:
        found = own(action, **fields)
        if replayed is not None:
            found = replayed[min(len(controls), len(replayed) - 1)].expand_as(found)
        controls.append(found.clone())
        return found

    actuation.control = control  # type: ignore[method-assign]
    environment.reset(seed=1)
    where = environment.device
    done = torch.full((worlds,), torch.inf, device=where)
    playing = torch.ones(worlds, dtype=torch.bool, device=where)
    idle = torch.zeros(worlds, environment.action_size, device=where)
    for decision in range(decisions):
        step = environment.step(idle)
        done[playing & step.terminated & ~step.failed] = decision + 1.0
        playing &= ~step.ended
        if not playing.any():
            break
    environment.close()
    return done, torch.stack(controls)


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--worlds", type=int, default=100)
    parser.add_argument("--only", nargs="+", choices=list(PLAYED), default=list(FIRST))
    parser.add_argument("--machine", default="one busy CPU core", help="on record")
    parser.add_argument("--record", type=Path, default=RECORD)
    parser.add_argument("overrides", nargs="*")
    options = parser.parse_args()
    for name in options.only:
        words, decisions = PLAYED[name]
        words = [*words, *CPU, *options.overrides]
        met, controls = outcomes(words, options.worlds, decisions)
        if not met.isfinite().any():
            raise SystemExit(f"No episode of '{name}' succeeds: there is nothing to replay.")
        first = int(met.isfinite().nonzero()[0])
        periods = PERIODS * int(met[first])
        again, _ = outcomes(words, options.worlds, int(met[first]) + 10, controls[:periods, first])
        others = again.isfinite()
        others[first] = False
        row = {
            "subtasks": name, "when": datetime.date.today().isoformat(), "machine": options.machine, "edge": 0.03,
            "worlds": options.worlds, "seed": 1, "policy": int(met.isfinite().sum()),
            "replayed": first, "decisions": met[first].item(), "again": bool(again[first].isfinite()),
            "others": options.worlds - 1, "replay": int(others.sum()),
        }  # fmt: skip
        print(row, flush=True)
        append(options.record, row)


if __name__ == "__main__":
    main()
