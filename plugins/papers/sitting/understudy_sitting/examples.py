"""Trials to look at: one success for each zone, and one of the commonest kind of failure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.running.step import Step
from understudy.setup.building import Built
from understudy_report.video import write_video
from understudy_sitting.trials import SEATED, built_for, skills_of
from understudy_skills.episodes import act_out, policy_of
from understudy_skills.skill import Skill

#: Of a video, in pixels; and about so many frames a second.
_WIDTH, _HEIGHT, _RATE = 480, 270, 30


@dataclass(frozen=True)
class Example:
    """A trial from its beginning to its end."""

    title: str
    tracks: dict[str, np.ndarray]  #: (T, …), a row each control period, by field


def film(skill: Skill, folder: Path, trials: int) -> list[dict[str, str]]:
    """Write ``trials_1.mp4`` and so on of `trials` trials of their own draw into `folder`; returns what each
    shows (``title``) and its name (``file``)."""
    built = built_for(skill, trials)
    try:
        chosen = choose(watch(built, skill, "examples"), skills_of(skill.experiment))
    finally:
        built.environment.close()
    for old in folder.glob("trials_*.mp4"):
        old.unlink()
    dt = built.environment.control_dt
    every = max(1, round(1.0 / (_RATE * dt)))
    made = []
    for number, example in enumerate(chosen, start=1):
        path = folder / f"trials_{number}.mp4"
        tracks = {name: track[::every] for name, track in example.tracks.items()}
        write_video(path, built.scene.draw(tracks, _WIDTH, _HEIGHT), 1.0 / (every * dt))
        made.append({"title": example.title, "file": path.name})
    return made


@dataclass(frozen=True)
class Watched:
    """A batch of N trials, each from its beginning to its end."""

    tracks: list[dict[str, Tensor]]  #: by field, (N, …), a row each control period
    end: Tensor  #: (N,) rows of each trial
    seated: Tensor  #: (N,) s, the longest uninterrupted sitting
    fell: Tensor  #: (N,) bool
    zone: Tensor  #: (N,) in which it began
    at_work: Tensor  #: (N,) which skill was, at its end

    @property
    def success(self) -> Tensor:
        """(N,) bool, as section 7 has it."""
        return self.seated >= SEATED - 1e-3

    def track(self, world: int) -> dict[str, np.ndarray]:
        """(T, …) by field, of one trial."""
        own = self.tracks[: int(self.end[world])]
        return {name: torch.stack([row[name][world] for row in own]).numpy() for name in own[0]}


def watch(built: Built, skill: Skill, draw: str) -> Watched:
    """Carry out as many trials as there are worlds in what was `built` of `skill`, from the starts of the
    random stream `draw`."""
    environment, table = built.environment, built.environment.table
    policy = policy_of(skill, built)
    root = skill.experiment.root
    environment.reset(root.seed, draw)
    n, zone = environment.num_worlds, table["zone"].cpu().clone()
    seated, end = torch.zeros(n), torch.zeros(n, dtype=torch.long)
    fell, at_work = torch.zeros(n, dtype=torch.bool), torch.zeros(n, dtype=torch.long)
    names = [name for name in built.scene.recorded if name in table.shapes]
    tracks: list[dict[str, Tensor]] = []

    def sit(running: Tensor) -> None:
        longest = seated.maximum(table["seated_seconds"].cpu())
        seated.copy_(torch.where(running.cpu(), longest, seated))

    def see(running: Tensor) -> None:
        tracks.append({name: table[name].cpu().clone() for name in names})
        sit(running)

    def decided(running: Tensor, step: Step) -> None:
        sit(running)
        counted = running.cpu()
        at_work[counted] = table["switch"].cpu().long()[counted]
        fell.logical_or_(counted & step.failed.cpu())
        end[counted] = len(tracks)

    act_out(environment, policy, root.evaluation.seconds, see=see, decided=decided)
    return Watched(tracks, end, seated, fell, zone, at_work)


def choose(watched: Watched, skills: Sequence[str]) -> list[Example]:
    """The first success of each zone, and the first of the commonest failures; `skills` in the order of
    the switch."""
    success = watched.success
    found = []
    for number in sorted({int(zone) for zone in watched.zone.tolist()}):
        for world in (success & (watched.zone == number)).nonzero()[:1, 0].tolist():
            found.append((f"zone {number}", world))
    failed = (~success).nonzero()[:, 0].tolist()
    kinds = {world: (bool(watched.fell[world]), int(watched.at_work[world])) for world in failed}
    for kind, count in Counter(kinds.values()).most_common(1):
        how = "falls" if kind[0] else "does not sit for long enough"
        skill = skills[kind[1]].rpartition("/")[2]
        title = f"{count} of {len(failed)} failures: it {how}, {skill} at work"
        found.append((title, next(world for world, own in kinds.items() if own == kind)))
    return [Example(title, watched.track(world)) for title, world in found]
