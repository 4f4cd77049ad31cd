"""Trials to look at: one success for each zone, and one of the commonest kind of failure."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass

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
        chosen = choose(watch(built, run, experiment, "examples"), skills_of(experiment))
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


@torch.no_grad()
def watch(built: Built, run: Run, experiment: Experiment, draw: str) -> Watched:
    """Carry out as many trials as there are worlds, from the starts of the random stream `draw`, by the
    newest policy of `run`, acting by its mode."""
    environment, table = built.environment, built.environment.table
    policy, _ = learned(experiment, built.context, run)
    environment.reset(experiment.root.seed, draw)
    n, zone = environment.num_worlds, table["zone"].cpu().clone()
    seated, end = torch.zeros(n), torch.zeros(n, dtype=torch.long)
    fell, at_work = torch.zeros(n, dtype=torch.bool), torch.zeros(n, dtype=torch.long)
    running = torch.ones(n, dtype=torch.bool)
    names = [name for name in built.scene.recorded if name in table.shapes]
    tracks: list[dict[str, Tensor]] = []

    def see() -> None:
        tracks.append({name: table[name].cpu().clone() for name in names})
        longest = seated.maximum(table["seated_seconds"].cpu())
        seated.copy_(torch.where(running, longest, seated))

    environment.on_period = see
    seconds = environment.decision * environment.control_dt
    for _ in range(max(1, round(experiment.root.evaluation.seconds / seconds))):
        action = policy.distribution(environment.observations).mode()
        step = environment.advance(action)
        see()
        tracks.pop()  # the next decision begins in it
        at_work[running] = table["switch"].cpu().long()[running]
        fell |= running & step.failed.cpu()
        end[running] = len(tracks)
        running &= ~step.ended.cpu()
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
