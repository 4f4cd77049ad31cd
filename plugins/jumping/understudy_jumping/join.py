"""``understudy jumping join``: a run-up and the jump that begins where it ended, as one motion."""

from __future__ import annotations

import argparse
from dataclasses import replace
from pathlib import Path

import torch
from torch import Tensor

from understudy.command.command import Command
from understudy.errors import FileError
from understudy.setup.plugins import installed
from understudy_basics import rotations
from understudy_characters.recording import recorded_clips
from understudy_motion.clip import Clip
from understudy_motion.writing import write_clip


class Join(Command):
    """Writes the motion of two runs' recordings, the run-up moved to where the jump begins."""

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run_up", help="run folder of the run-up")
        parser.add_argument("jump", help="run folder of the jump")
        parser.add_argument("destination", type=Path, help="the file to write, such as jump.npz")

    def run(self, options: argparse.Namespace) -> int:
        first, _ = recorded_clips(options.run_up)
        second, _ = recorded_clips(options.jump)
        whole = joined(first, second)
        write_clip(whole, options.destination, installed().registry)
        print(f"{options.destination}: {whole.duration:.2f} s, taken off at {first.duration:.2f} s")
        return 0


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
