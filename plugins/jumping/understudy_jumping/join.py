"""``understudy jumping join``: a run-up and the jump that begins where it ended, as one motion."""

from __future__ import annotations

import argparse
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.command.command import Command
from understudy.errors import FileError
from understudy.records import runs
from understudy.setup.building import build_sections
from understudy.setup.plugins import installed
from understudy.task import Context
from understudy_basics import rotations
from understudy_characters.recording import check_frames, recorded_clips, recorded_fields
from understudy_characters.scene import CharacterScene
from understudy_motion.clip import Clip
from understudy_motion.writing import write_clip
from understudy_report.video import write_video

#: Frames a second of the video.
RATE = 30.0
#: Frames times joints of the video at most: ten minutes of a humanoid. Where each limb is drawn takes
#: more memory than its rotation.
_MOST = 270_000


class Join(Command):
    """Writes the motion of two runs' recordings, the run-up moved to where the jump begins: as a clip
    of any format, or as a video with the jump's obstacle."""

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run_up", help="run folder of the run-up")
        parser.add_argument("jump", help="run folder of the jump")
        parser.add_argument(
            "destination", type=Path, help="the file to write: jump.npz, jump.bvh or jump.mp4"
        )

    def run(self, options: argparse.Namespace) -> int:
        first, _ = recorded_clips(options.run_up)
        second, _ = recorded_clips(options.jump)
        whole = joined(first, second)
        if options.destination.suffix.lower() == ".mp4":
            write_video(options.destination, _frames(whole, Path(options.jump)), RATE)
        else:
            write_clip(whole, options.destination, installed().registry)
        print(f"{options.destination}: {whole.duration:.2f} s, taken off at {first.duration:.2f} s")
        return 0


def _frames(clip: Clip, jump: Path) -> Iterator[np.ndarray]:
    """The motion drawn in the scene of the run `jump`, its obstacle as recorded there."""
    cure = "record runs of fewer seconds, or write a clip (jump.npz)"
    check_frames(clip, clip.duration * RATE, cure, _MOST)
    run = runs.open_run(jump)
    experiment = run.experiment(installed().registry)
    control = experiment.root.control
    context = Context(
        seed=0,
        device=torch.device("cpu"),
        num_worlds=1,
        control_dt=1.0 / control.frequency,
        substeps=control.substeps,
        sections=build_sections(experiment),
        inputs=experiment.inputs,
    )
    scene = experiment.need("scene").build(context)
    assert isinstance(scene, CharacterScene)  # else its recording had been no clip
    times = torch.arange(0.0, clip.duration, 1.0 / RATE, dtype=torch.float64)
    tracks = {"qpos": scene.character.qpos(clip, times).numpy()}
    for name, recorded in recorded_fields(run, scene).items():
        tracks[name] = np.repeat(recorded[:1], len(times), axis=0)
    return scene.draw(tracks)


def joined(first: Clip, second: Clip) -> Clip:
    """`first`, turned about the vertical and moved on the ground so that it ends where `second` begins,
    then `second`.

    Raises
    ------
    FileError
        if they are not of the same joints.
    """
    if first.joint_names != second.joint_names:
        raise FileError(f"{first.source} and {second.source} are not of the same character.")
    ends, begins = first.rotations[-1, 0], second.rotations[0, 0]
    turn = rotations.from_heading(rotations.heading(begins) - rotations.heading(ends))
    moved = rotations.rotate(turn, first.root_position)
    shift: Tensor = second.root_position[0] - moved[-1]
    shift = torch.cat([shift[:2], torch.zeros_like(shift[2:])])
    turned = first.rotations.clone()
    turned[:, 0] = rotations.multiply(turn, turned[:, 0])
    return replace(
        second,
        name=f"{first.name}-{second.name}",
        # the jump's first frame is the run-up's last
        times=torch.cat([first.times, first.times[-1] + second.times[1:]]),
        root_position=torch.cat([moved + shift, second.root_position[1:]]),
        rotations=torch.cat([turned, second.rotations[1:]]),
    )
