"""``understudy export``: a run's motion, or a clip, as a file of any format that is written."""

from __future__ import annotations

import argparse
import contextlib
import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path

import torch

from understudy.command.command import Command
from understudy.errors import ConfigError, FileError
from understudy.setup.plugins import installed
from understudy.setup.registry import Registry
from understudy_characters.character import Character
from understudy_characters.fitting import fitting_character, worn
from understudy_characters.recording import (
    WITH_SURROUNDINGS,
    check_frames,
    chosen_character,
    recorded_clips,
    recorded_surroundings,
    run_character,
)
from understudy_characters.shapes import bones, shapes
from understudy_credits.walk import answer, in_a_line, open_made
from understudy_export.figure import figure
from understudy_motion.arguments import add_reading, frame_rate, open_clip, positive, refuse_reading
from understudy_motion.clip import Clip, resample, sample
from understudy_motion.kinematics import need_skeleton
from understudy_motion.reading import metres_of
from understudy_motion.writing import Shape, Shown, write_figures, writer_of
from understudy_mujoco.studio import REFERENCE
from understudy_skills.folder import run_folder

BONES = "none"
ONNX = ".onnx"
PAGES = (".html", ".htm")
REFERENCE_TABLE = ".reference.npz"
"""The ending of what is written beside a policy that follows a motion."""
OF_MOTIONS = (
    "reference", "beside", "character", "rate", "seconds", "cycles",
    "unit", "up", "skeleton", "source_rate",
)  # fmt: skip
"""Options that mean nothing to a policy, nor to a page of what was recorded."""
BESIDE = 0.74
"""In heights of the figure: how far to the left the reference is put, as in videos."""
CURE = "give a lower --rate, fewer --seconds or fewer --cycles"
"""Of too many frames."""
GAMMA = 2.2
"""Of colours on screens; those of files are linear."""


class Export(Command):
    """Writes the learned motion of a run, its policy, or a clip as a file; the file's ending says in which format.

    For a run, .glb and .gltf files also have what stands around the figure.
    """

    example = "understudy export runs/spacetime-walk-001 walk.glb"

    def arguments(self, parser: argparse.ArgumentParser) -> None:
        parser.add_argument(
            "source",
            help="a run folder, a skill, a clip file, or a clip's name",
        )
        parser.add_argument(
            "destination",
            type=Path,
            help="the file to write, such as walk.glb, .usdc or .bvh; policy.onnx is the trained policy, page.html "
            "plays what was recorded in a browser",
        )
        parser.add_argument(
            "--reference", action="store_true", help="write the motion that the run learned from"
        )
        parser.add_argument(
            "--beside",
            action="store_true",
            help="also write the run's reference, to the left of what it learned (.glb, .gltf)",
        )
        parser.add_argument(
            "--character",
            metavar="NAME",
            help="the figure that is written: a character, an MJCF file, that of a run folder, or none for bones; by default "
            "the run's, or the one that the clip fits",
        )
        parser.add_argument("--rate", type=frame_rate, metavar="HZ", help="frames per second")
        length = parser.add_mutually_exclusive_group()
        length.add_argument(
            "--seconds",
            type=positive,
            help="write this many seconds from the beginning; a looping clip goes on for as long",
        )
        length.add_argument(
            "--cycles", type=_count, help="write this many cycles of a looping clip"
        )
        add_reading(parser)

    def writes(self, options: argparse.Namespace) -> Iterator[Path | None]:
        yield options.destination
        if options.destination.suffix.lower() == ONNX:
            yield options.destination.with_suffix(REFERENCE_TABLE)

    def run(self, options: argparse.Namespace) -> int:
        if options.destination.suffix.lower() == ONNX:
            return _policy(options)
        registry = installed().registry
        page = options.destination.suffix.lower() in PAGES
        if not page:  # before a skill is recorded, which takes time
            _check_format(options.destination, registry)
        # A skill's licence is its distribution's, of which its recording's folder knows nothing.
        options.made = options.source
        options.source = run_folder(options.source, recorded=True)
        if page:
            return _page(options)
        from understudy_export.cloth import garment_of, write_cloth

        garment = garment_of(options.source)
        if garment is not None:
            _refuse_options(options, "is of a garment", but=("rate", "seconds"))
            destination, line = options.destination, in_a_line(open_made(options.made))
            licence = "; ".join(filter(None, line))
            print(
                write_cloth(
                    options.source, garment, destination, options.rate, options.seconds, licence
                )
            )
            return 0
        clip, character = _moving(options, registry)
        if options.character == BONES:
            character = None
        elif options.character is not None:
            character = chosen_character(options.character, registry)
        if character is not None:
            clip = worn(clip, character)
        clip = timed(clip, rate=options.rate, seconds=options.seconds, cycles=options.cycles)
        surface = [] if character is None else shapes(character)
        figures = [Shown(clip, surface)]
        if options.beside:
            figures.append(_beside(options, surface))
        if _with_surroundings(options):
            for thing in recorded_surroundings(options.source):
                timing = {"rate": options.rate, "seconds": options.seconds}
                figures.append(replace(thing, clip=timed(thing.clip, **timing)))
        if Path(options.source).is_dir() and options.unit is not None:
            figures = [replace(f, clip=_in_unit(f.clip, options)) for f in figures]
        write_figures(figures, options.destination, registry)
        line = _summary(clip, options.destination, character)
        if (
            not _with_surroundings(options)
            and _learned(options)
            and (left := _left_out(options.source))
        ):
            line += f" · without {left} of the scene, which {' and '.join(WITH_SURROUNDINGS)} files have"
        print(line)
        return 0


def _page(options: argparse.Namespace) -> int:
    _refuse_options(options, "shows all that was recorded")
    from understudy_export.page import write_page

    print(write_page(options.source, options.destination, options.made))
    return 0


def _refuse_options(options: argparse.Namespace, why: str, but: Sequence[str] = ()) -> None:
    for name in (one for one in OF_MOTIONS if one not in but):
        if getattr(options, name) not in (None, False):
            raise ConfigError(
                f"--{name.replace('_', '-')} is for motions, and {options.destination} {why}: leave it out."
            )


def _check_format(destination: Path, registry: Registry) -> None:
    try:
        writer_of(destination, registry)
    except FileError as error:
        raise FileError(
            f"{error} A run can also be written as {ONNX}, its policy, and {PAGES[0]}, a page that plays it."
        ) from error


def _policy(options: argparse.Namespace) -> int:
    _refuse_options(options, "is a policy")
    from understudy_export.policy import write_policy
    from understudy_skills.folder import MAKE_A_RUN
    from understudy_skills.pack import others_named
    from understudy_skills.skill import open_skill

    skill = open_skill(options.source)
    with others_named(skill, options.source, MAKE_A_RUN.replace("SKILL", options.source)):
        lines = write_policy(skill, options.destination, answer(open_made(options.source)))
    for line in lines:
        print(line)
    return 0


def _with_surroundings(options: argparse.Namespace) -> bool:
    """Of runs, into files that hold several motions: the chair that the figure sits on, say."""
    return _learned(options) and options.destination.suffix.lower() in WITH_SURROUNDINGS


def _learned(options: argparse.Namespace) -> bool:
    """Whether it is of a run, and what that learned rather than what from."""
    return Path(options.source).is_dir() and not options.reference


def _left_out(source: str) -> str:
    """How many bodies of a run's scene a file of one figure lacks, or nothing."""
    with contextlib.suppress(FileError):  # a figure of which the rest was not recorded
        if count := len(recorded_surroundings(source)):
            return f"{count} other bod{'y' if count == 1 else 'ies'}"
    return ""


def _beside(options: argparse.Namespace, surface: Sequence[Shape]) -> Shown:
    """The reference of the run, in its colour, as long as the motion that it is put beside."""
    path = Path(options.source)
    if not path.is_dir() or options.reference:
        raise ConfigError(
            "--beside is not possible: it puts a run's reference beside what it learned."
        )
    clip = recorded_clips(path)[1]
    if clip is None:
        raise FileError(f"{path}: its task has no reference motion to export.")
    clip = timed(clip, rate=options.rate, seconds=options.seconds, cycles=options.cycles)
    body = figure(clip, surface)
    tall = max(float(s.positions[:, 2].max()) for s in body.surfaces)
    orange = (*(c**GAMMA for c in REFERENCE[:3]), 1.0)
    shown = [replace(shape, colour=orange) for shape in surface or bones(body.skeleton)]
    return Shown(clip, shown, BESIDE * tall)


def _in_unit(clip: Clip, options: argparse.Namespace) -> Clip:
    """The motion of a run, so that a BVH file of it has lengths in the unit that is asked for."""
    if options.destination.suffix.lower() != ".bvh":
        if metres_of(options.unit) == 1.0:
            return clip
        raise ConfigError(
            f"--unit {options.unit} is not possible: '{options.destination.suffix}' files are in "
            "metres; only .bvh has a unit of its own."
        )
    factor = 0.01 / metres_of(options.unit)
    skeleton = need_skeleton(clip)
    tips = {name: factor * tip for name, tip in skeleton.tips.items()}
    skeleton = replace(skeleton, offsets=factor * skeleton.offsets, tips=tips)
    return replace(clip, root_position=factor * clip.root_position, skeleton=skeleton)


def _moving(options: argparse.Namespace, registry: Registry) -> tuple[Clip, Character | None]:
    """What the command's arguments name, and the character that it moves."""
    path = Path(options.source)
    if path.is_dir():
        learned, reference = recorded_clips(path)
        refuse_reading(options, options.source, ("up", "skeleton", "source_rate", "angles"))
        if learned is not None and not options.reference:
            licence, attribution = in_a_line(open_made(options.made, registry), registry)
            learned = replace(learned, licence=licence, attribution=attribution)
        clip = reference if options.reference else learned
        if clip is None:
            raise FileError(f"{path}: its task has no reference motion to export.")
        return clip, run_character(path)
    if options.reference:
        raise ConfigError(f"--reference is not possible: {path} is no run folder.")
    clip = open_clip(options.source, options, registry)
    return clip, fitting_character(clip, registry)


def timed(
    clip: Clip,
    *,
    rate: float | None = None,
    seconds: float | None = None,
    cycles: int | None = None,
) -> Clip:
    """`clip` at another rate and of another length; None leaves it as it is.

    Parameters
    ----------
    clip
        the clip.
    rate
        frames per second; of whole cycles the nearest that makes them end on a frame.
    seconds
        at most so many from the beginning; a looping clip goes on over its end.
    cycles
        this many of a looping clip, each one where the one before left off.

    Raises
    ------
    FileError
        cycles of a clip that does not loop, too little time, or too many frames.
    """
    if cycles is not None:
        clip = _repeated(clip, cycles)
    if seconds is None and rate is None:
        return clip
    rate = rate or clip.frame_rate
    if seconds is None and clip.loop:
        check_frames(clip, clip.duration * rate, CURE)
        if round(clip.duration * rate) < 2:
            raise FileError(
                f"Clip {clip.source}: a cycle of {clip.duration:.4g} s at {rate:g} Hz is one pose; give a higher --rate."
            )
        return resample(clip, rate)
    length = min(seconds or clip.duration, math.inf if clip.loop else clip.duration)
    check_frames(clip, length * rate, CURE)
    steps = math.floor(length * rate + 1e-6)
    if steps < 1:
        raise FileError(
            f"Clip {clip.source}: {length:g} s at {rate:g} Hz are less than two frames; give more "
            "--seconds or a higher --rate."
        )
    times = torch.arange(steps + 1, dtype=torch.float64) / rate
    position, rotation = sample(clip, times)
    return replace(clip, times=times, root_position=position, rotations=rotation, loop=False)


def _repeated(clip: Clip, cycles: int) -> Clip:
    """`cycles` of `clip` at its own frames; together they loop again."""
    if not clip.loop:
        raise FileError(
            f"Clip {clip.source}: it does not loop, so it has no cycles to repeat; --seconds cuts it."
        )
    check_frames(clip, cycles * clip.num_frames, CURE)
    starts = clip.duration * torch.arange(cycles, dtype=torch.float64)
    times = torch.cat(((starts[:, None] + clip.times[:-1]).flatten(), cycles * clip.times[-1:]))
    position, rotation = sample(clip, times)
    return replace(clip, times=times, root_position=position, rotations=rotation)


def _summary(clip: Clip, destination: Path, character: Character | None) -> str:
    parts = [
        f"{clip.num_frames} frames at {clip.frame_rate:g} Hz",
        f"{clip.duration:.2f} s{', looping' if clip.loop else ''}",
        f"{len(clip.joint_names)} joints{f' of {character.name}' if character else ''}",
        f"licence: {clip.licence}" if clip.licence else "",
    ]
    return f"{destination}: {' · '.join(filter(None, parts))}"


def _count(text: str) -> int:
    value = int(text)
    if value < 1:
        raise argparse.ArgumentTypeError(f"{text} is less than 1")
    return value
