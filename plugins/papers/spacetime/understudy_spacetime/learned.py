"""``understudy motion learned``: a reference repaired by learning, written back as a clip."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from understudy.command.command import Command
from understudy.errors import FileError
from understudy.records import runs
from understudy.setup.plugins import installed
from understudy_characters.recording import recorded_clips
from understudy_credits.walk import in_a_line, open_made
from understudy_motion.clip import Clip, cycle_transform, resample
from understudy_motion.editing import close_loop, cut
from understudy_motion.readers.npz import Archive
from understudy_motion.writing import write_clip
from understudy_skills.folder import run_folder
from understudy_tensors.rotations import angle_between


class Learned(Command):
    """Writes the cycle of a run's recorded motion that closes best, as a clip that loops: what physics has made of a
    poor reference. Other trainings can learn from it instead of the reference."""

    example = "understudy motion learned runs/spacetime-walk-001 repaired.npz"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run", help="the folder of a run that learned a clip, or a skill")
        parser.add_argument("destination", type=Path, help="the clip to write, such as walk.npz")

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.destination

    def run(self, options: argparse.Namespace) -> int:
        clip = learned_clip(run_folder(options.run, recorded=True))
        # on the terms of everything behind the run, not of its reference alone
        licence, attribution = in_a_line(open_made(options.run))
        clip = replace(clip, licence=licence, attribution=attribution)
        write_clip(clip, options.destination, installed().registry)
        how = f"one cycle of {clip.duration:.2f} s" if clip.loop else f"{clip.duration:.2f} s"
        print(f"{options.destination}: {how}, {clip.num_frames} frames, licence: {clip.licence}")
        return 0


def learned_clip(path: str) -> Clip:
    """The motion that the run folder `path` recorded, cut where the phase begins anew.

    Of a reference that loops it is one whole cycle, the one whose last pose is nearest to its first,
    closed; of another, all of the episode.

    Raises
    ------
    RunError
        it is no run folder.
    FileError
        it has no recording of a motion with a phase, or one that ends before a whole cycle.
    """
    learned, reference = recorded_clips(path)
    archive = Archive(runs.open_run(path).path / "recording.npz")
    if reference is None or "phase" not in archive.names:
        raise FileError(f"{path}: its task has no reference motion, so there is nothing to repair.")
    phase = torch.from_numpy(archive.floats("phase", None)[: learned.num_frames])
    starts = cycle_starts(phase, learned.times)
    if len(starts) == 0:
        return learned
    spans = list(zip(starts[:-1].tolist(), starts[1:].tolist(), strict=True))
    if not spans:
        seconds = math.ceil(3 * learned.duration)
        raise FileError(
            f"{path}: its recording ends before a whole cycle of the clip; make a longer one with "
            f"`understudy render {path} seconds={seconds}`, and give {path}/renders/seconds-{seconds}."
        )
    cycles = [
        (cut(learned, start, stop), cut(reference, start, min(stop, reference.duration)))
        for start, stop in spans
    ]
    best, _ = min(cycles, key=lambda pair: seam(*pair))
    even = resample(replace(best, name=f"{learned.name}-learned"), learned.frame_rate)
    return close_loop(even)


def cycle_starts(phase: Tensor, times: Tensor) -> Tensor:
    """(K,) s at which `phase` (T,), in [0, 1) at `times` (T,), passes through 0."""
    step = phase[1:] - phase[:-1]
    wraps = (step < -0.5).nonzero().squeeze(1)
    rate = (step + 1.0)[wraps]  # of the phase, over the step that passes 0
    return times[wraps] + (1.0 - phase[wraps]) / rate * (times[1:] - times[:-1])[wraps]


def seam(clip: Clip, reference: Clip) -> float:
    """rad: the largest angle of a joint between the first and the last pose, plus how much more or less
    the clip turns about the vertical than its reference does meanwhile."""
    joints = float(angle_between(clip.rotations[0, 1:], clip.rotations[-1, 1:]).amax())
    turns = cycle_transform(clip).heading - cycle_transform(reference).heading
    return joints + abs(math.remainder(turns, 2.0 * math.pi))
