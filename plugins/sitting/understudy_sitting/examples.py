"""Trials to look at: one success for each zone, and one of the commonest kind of failure."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.records.runs import Run
from understudy.setup.building import Built, build_environment
from understudy.setup.config import Experiment
from understudy_report.video import write_video
from understudy_sitting.trials import SEATED, learned, skills_of

#: Of a video, in pixels; and about so many frames a second.
_WIDTH, _HEIGHT, _RATE = 480, 270, 30


@dataclass(frozen=True)
class Example:
    """A trial from its beginning to its end."""

    title: str
    tracks: dict[str, np.ndarray]  #: (T, …), a row each control period, by field


def film(experiment: Experiment, run: Run, trials: int) -> list[dict[str, str]]:
    """Write ``trials_1.mp4`` and so on of `trials` trials of their own draw into the folder of `run`;
    returns what each shows (``title``) and its name (``file``)."""
    built = build_environment(
        experiment, num_worlds=trials, episode_seconds=experiment.root.evaluation.seconds, evaluating=True
    )  # fmt: skip
    try:
        chosen = choose(built, run, experiment)
    finally:
        built.environment.close()
    for old in run.path.glob("trials_*.mp4"):
        old.unlink()
    dt = built.environment.control_dt
    every = max(1, round(1.0 / (_RATE * dt)))
    made = []
    for number, example in enumerate(chosen, start=1):
        path = run.path / f"trials_{number}.mp4"
        tracks = {name: track[::every] for name, track in example.tracks.items()}
        write_video(Path(path), built.scene.draw(tracks, _WIDTH, _HEIGHT), 1.0 / (every * dt))
        made.append({"title": example.title, "file": path.name})
    return made


@torch.no_grad()
def choose(built: Built, run: Run, experiment: Experiment) -> list[Example]:
    """Of one batch of trials the first success of each zone, and the first of the commonest failures."""
    environment, table = built.environment, built.environment.table
    policy, _ = learned(experiment, built.context, run)
    environment.reset(experiment.root.seed, "examples")
    n, zone = environment.num_worlds, table["zone"].clone()
    seated, end = torch.zeros(n), torch.zeros(n, dtype=torch.long)
    fell, at_work = torch.zeros(n, dtype=torch.bool), torch.zeros(n, dtype=torch.long)
    running = torch.ones(n, dtype=torch.bool)
    names = [name for name in built.scene.recorded if name in table.shapes]
    periods: list[dict[str, Tensor]] = []

    def see() -> None:
        periods.append({name: table[name].cpu().clone() for name in names})
        longest = seated.maximum(table["seated_seconds"].cpu())
        seated.copy_(torch.where(running, longest, seated))

    environment.on_period = see
    seconds = environment.decision * environment.control_dt
    for _ in range(max(1, round(experiment.root.evaluation.seconds / seconds))):
        action = policy.distribution(environment.observations).mode()
        step = environment.advance(action)
        see()
        periods.pop()  # the next decision begins in it
        at_work[running] = table["switch"].cpu().long()[running]
        fell |= running & step.failed.cpu()
        end[running] = len(periods)
        running &= ~step.ended.cpu()

    success = seated >= SEATED - 1e-3
    skills = [skill.rpartition("/")[2] for skill in skills_of(experiment)]
    found = []
    for number in sorted({int(k) for k in zone.tolist()}):
        for world in (success & (zone.cpu() == number)).nonzero()[:1, 0].tolist():
            found.append((f"zone {number}", world))
    kinds = {k: (bool(fell[k]), int(at_work[k])) for k in (~success).nonzero()[:, 0].tolist()}
    for kind, count in Counter(kinds.values()).most_common(1):
        how = "falls" if kind[0] else "does not sit for long enough"
        title = f"{count} of {len(kinds)} failures: it {how}, {skills[kind[1]]} at work"
        found.append((title, next(world for world, own in kinds.items() if own == kind)))
    return [
        Example(
            title,
            {
                k: torch.stack([p[k][world] for p in periods[: int(end[world])]]).numpy()
                for k in names
            },
        )
        for title, world in found
    ]
