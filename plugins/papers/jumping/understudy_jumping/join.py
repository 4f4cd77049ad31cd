"""``understudy jumping join``: a run-up and the jump that begins where it ended, as one motion."""

from __future__ import annotations

import argparse
import math
from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path

import numpy as np
import torch
from torch import Tensor

from understudy.command.command import Command
from understudy.errors import FileError
from understudy.records import runs
from understudy.setup.plugins import installed
from understudy_characters.recording import (
    WITH_SURROUNDINGS,
    check_frames,
    recorded_clips,
    recorded_fields,
    recorded_scene,
    recorded_surroundings,
    run_character,
)
from understudy_characters.scene import CharacterScene
from understudy_characters.shapes import shapes
from understudy_credits.walk import in_a_line, open_made
from understudy_motion.arguments import finite
from understudy_motion.clip import Clip, resample, sample
from understudy_motion.writing import Shown, write_figures
from understudy_report.values import mapping
from understudy_report.video import write_video
from understudy_skills.folder import run_folder
from understudy_tensors import rotations

#: Frames a second of the video.
RATE = 30.0
#: Frames times joints of the video at most: ten minutes of a humanoid. Where each limb is drawn takes
#: more memory than its rotation.
_MOST = 270_000


class Join(Command):
    """Writes the motion of two runs' recordings, the run-up moved to where the jump begins: as a clip
    of any format, or as a video. Videos, .glb and .gltf files also have the jump's obstacle and mat."""

    example = "understudy jumping join runs/run_up runs/jump jump.mp4"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument("run_up", help="run folder of the run-up, or a skill")
        parser.add_argument("jump", help="run folder of the jump, or a skill")
        parser.add_argument(
            "destination",
            type=Path,
            help="the file to write: jump.npz, jump.bvh, jump.glb or jump.mp4",
        )

        parser.add_argument(
            "--camera",
            type=finite,
            default=60.0,
            metavar="DEGREES",
            help="of a video, which way the camera looks: 0 across the obstacle, as the athlete "
            "jumps, 90 along it (default: %(default)g)",
        )

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.destination

    def run(self, options: argparse.Namespace) -> int:
        of = [run_character(run_folder(run)) for run in (options.run_up, options.jump)]
        if of[0].joint_names != of[1].joint_names:  # before what takes half a minute of each
            raise FileError(f"{options.run_up} and {options.jump} are not of the same character.")
        _check_order(options.run_up, options.jump)
        # A skill's licence is its distribution's, of which its recording's folder knows nothing.
        made = (options.run_up, options.jump)
        options.run_up = run_folder(options.run_up, recorded=True)
        options.jump = run_folder(options.jump, recorded=True)
        first, _ = recorded_clips(options.run_up)
        second, _ = recorded_clips(options.jump)
        whole = _on_their_terms(joined(first, second), *made)
        if options.destination.suffix.lower() == ".mp4":
            frames = _frames(whole, Path(options.jump), options.camera)
            write_video(options.destination, frames, RATE)
        else:
            figures = _figures(whole, options.jump, options.destination)
            write_figures(figures, options.destination, installed().registry)
        off = whole.duration - second.duration
        print(f"{options.destination}: {whole.duration:.2f} s, taken off at {off:.2f} s")
        angle, height = gap(first, second)
        print(
            f"Where the run-up ends, the root is {100 * height:.1f} cm higher or lower than where the jump "
            f"begins, and the joint that differs most is off by {angle:.2f} rad."
        )
        return 0


def _check_order(run_up: str, jump: str) -> None:
    """Refuse a run-up that has an obstacle, and a jump that has none."""
    jumps = [_jumps(run_folder(run)) for run in (run_up, jump)]
    if jumps == [True, False]:
        raise FileError(
            f"{run_up} is a jump, and {jump} is none: exchange them, since the run-up comes first."
        )
    if not jumps[1]:
        raise FileError(
            f"{jump} is no jump: its task has no obstacle. Name the run of one second, as of experiment=jumping/high_gpu."
        )
    if jumps[0]:
        raise FileError(
            f"{run_up} is a jump itself: its task has an obstacle. Name the run of a run-up first, as of "
            "experiment=jumping/run_up_gpu."
        )


def _jumps(run: str) -> bool:
    """Whether the task of the run folder judges an attempt at an obstacle."""
    memories = mapping(runs.open_run(run).config.get("memory"))
    return any(mapping(memory).get("name") == "jumping/attempt" for memory in memories.values())


def _on_their_terms(clip: Clip, *made: str) -> Clip:
    """`clip` on the terms of the runs that it is `made` from, with whom they name."""
    terms = [in_a_line(open_made(run)) for run in made]
    licence, attribution = (
        dict.fromkeys(filter(None, texts)) for texts in zip(*terms, strict=True)
    )
    return replace(clip, licence=" AND ".join(licence), attribution=" ".join(attribution))


def _figures(clip: Clip, jump: str, destination: Path) -> list[Shown]:
    """The motion on the character of the run `jump`, then, where the file can hold it, what stands
    around that."""
    figures = [Shown(clip, shapes(run_character(jump)))]
    if destination.suffix.lower() in WITH_SURROUNDINGS:
        figures += [_waiting(thing, clip) for thing in recorded_surroundings(jump)]
    return figures


def _waiting(thing: Shown, whole: Clip) -> Shown:
    """`thing` of a jump with the frames of `whole`, which ends with that jump: until then it stands
    where it does as the jump begins."""
    clip = thing.clip
    position, rotation = sample(clip, whole.times - (whole.duration - clip.duration))
    moved = replace(clip, times=whole.times, root_position=position, rotations=rotation)
    return replace(thing, clip=moved)


def _frames(clip: Clip, jump: Path, camera: float) -> Iterator[np.ndarray]:
    """The motion drawn in the scene of the run `jump`, its obstacle as recorded there, by a camera that
    looks `camera` degrees about the vertical from across the obstacle."""
    cure = "record runs of fewer seconds, or write a clip (jump.npz)"
    check_frames(clip, clip.duration * RATE, cure, _MOST)
    run = runs.open_run(jump)
    scene = recorded_scene(run)
    assert isinstance(scene, CharacterScene)  # else its recording had been no clip
    scene.azimuth = camera
    times = torch.arange(0.0, clip.duration, 1.0 / RATE, dtype=torch.float64)
    tracks = {"qpos": scene.character.qpos(clip, times).numpy()}
    for name, recorded in recorded_fields(run, scene).items():
        tracks[name] = np.repeat(recorded[:1], len(times), axis=0)
    return scene.draw(tracks)


def gap(first: Clip, second: Clip) -> tuple[float, float]:
    """How far the pose that `second` begins in is from where `first` ends: rad of the joint that differs
    most, the root's heading aside, and m of the root's height."""
    position, ends = _end(first)
    begins = second.rotations[0].clone()
    for pose in (ends, begins):
        ahead = rotations.from_heading(-rotations.heading(pose[0]))
        pose[0] = rotations.multiply(ahead, pose[0])
    height = second.root_position[0, 2] - position[2]
    return float(rotations.angle_between(ends, begins).max()), float(height.abs())


def joined(first: Clip, second: Clip) -> Clip:
    """`first`, turned about the vertical and moved on the ground so that it ends where `second` begins,
    then `second`, at frames as far apart throughout as those of the one that has more of them a second. The state in which
    an episode ends is in no recording, so `first` goes on for one more frame as it moved in its last one.

    Raises
    ------
    FileError
        if they are not of the same joints.
    """
    if first.joint_names != second.joint_names:
        raise FileError(f"{first.source} and {second.source} are not of the same character.")
    position, pose = _end(first)
    begins = rotations.heading(second.rotations[0, 0])
    turn = rotations.from_heading(begins - rotations.heading(pose[0]))
    shift: Tensor = second.root_position[0] - rotations.rotate(turn, position)
    shift = torch.cat([shift[:2], torch.zeros_like(shift[2:])])
    turned = first.rotations.clone()
    turned[:, 0] = rotations.multiply(turn, turned[:, 0])
    rate = max(first.frame_rate, second.frame_rate)
    whole = replace(
        second,
        name=f"{first.name}-{second.name}",
        times=torch.cat([first.times, 2 * first.times[-1] - first.times[-2] + second.times]),
        root_position=torch.cat(
            [rotations.rotate(turn, first.root_position) + shift, second.root_position]
        ),
        rotations=torch.cat([turned, second.rotations]),
    )
    alike = math.isclose(first.frame_rate, second.frame_rate, rel_tol=1e-6)
    return whole if alike else resample(whole, rate)


def _end(clip: Clip) -> tuple[Tensor, Tensor]:
    """(3,) and (J, 4): where the root is and how the joints are turned a frame after the last one of
    `clip`, moved and turned on as from the one before to it."""
    before, last = clip.rotations[-2:]
    on = rotations.multiply(last, rotations.conjugate(before))
    position = 2 * clip.root_position[-1] - clip.root_position[-2]
    return position, rotations.multiply(on, last)
