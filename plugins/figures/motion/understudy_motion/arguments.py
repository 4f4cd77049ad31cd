"""What commands that take a clip have in common: how it is named and read."""

from __future__ import annotations

import argparse
import math
import typing
from collections.abc import Sequence
from pathlib import Path

from understudy.errors import ConfigError, FileError
from understudy.setup.registry import Registry
from understudy_motion import library
from understudy_motion.clip import Clip
from understudy_motion.reading import METRES, AngleUnit, Axis, NamedUnit, ReadOptions, Unit, no_rate

__all__ = [
    "add_reading",
    "finite",
    "frame_rate",
    "open_clip",
    "port",
    "positive",
    "refuse_reading",
    "share",
]


def add_reading(parser: argparse.ArgumentParser, *, loop: bool = True) -> None:
    """Add the options of :class:`ReadOptions`, as a group; `loop` says whether that one too."""
    group = parser.add_argument_group("what a clip file may leave unsaid")
    group.add_argument(
        "--unit", type=unit, metavar="UNIT", help=f"of its lengths: {', '.join(METRES)}, or metres"
    )
    group.add_argument("--up", choices=typing.get_args(Axis), help="its vertical axis")
    group.add_argument("--skeleton", type=Path, metavar="FILE", help="the ASF file of an AMC file")
    group.add_argument(
        "--angles", choices=typing.get_args(AngleUnit), help="the unit of its angles"
    )
    group.add_argument("--source-rate", type=frame_rate, metavar="HZ", help="its frames per second")
    parser.set_defaults(repeats=None)
    if loop:
        group.add_argument(
            "--loop",
            dest="repeats",
            action=argparse.BooleanOptionalAction,
            help="whether it repeats",
        )


def open_clip(source: str, options: argparse.Namespace, registry: Registry) -> Clip:
    """The clip that `source` names, a file or a clip's name, read as the `options` say.

    Raises
    ------
    FileError
        as :func:`library.find`, and for a run folder or a skill, which are no clips.
    """
    if not source:
        raise FileError("'' names no clip, as of an empty variable. Give a file or a clip's name.")
    if source in registry.names("skill") or (Path(source) / "run.json").is_file():
        raise FileError(
            f"{source} was learned, and a clip is wanted: `understudy export {source} FILE.npz` makes one of it."
        )
    if Path(source).is_dir():
        raise FileError(f"{source} is a folder, and neither a clip nor a run. Name the file in it.")
    reading = ReadOptions(
        unit=options.unit,
        up=options.up,
        skeleton=options.skeleton,
        loop=options.repeats,
        rate=options.source_rate,
        angles=options.angles,
    )
    return library.find(source, registry, reading)


def refuse_reading(
    options: argparse.Namespace,
    run: str,
    names: Sequence[str] = ("unit", "up", "skeleton", "source_rate", "angles"),
) -> None:
    """Raise :class:`ConfigError` for those of the options `names` that are given, of a `run` that leaves
    nothing unsaid."""
    for name in names:
        if getattr(options, name) is not None:
            raise ConfigError(f"--{name.replace('_', '-')} is of clip files; {run} is a run.")


def unit(text: str) -> Unit:
    """An argument's type: a unit of length, or the metres in it."""
    named = next((name for name in typing.get_args(NamedUnit) if name == text), None)
    try:
        return named or positive(text)
    except ValueError:
        raise argparse.ArgumentTypeError(
            f"{text!r} is none of {', '.join(METRES)}, and no number of metres"
        ) from None


def positive(text: str) -> float:
    """An argument's type: a finite number above 0."""
    value = float(text)
    if not 0.0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text} is not above 0")
    return value


def frame_rate(text: str) -> float:
    """An argument's type: frames per second that a motion may have."""
    value = positive(text)
    if why := no_rate(value):
        raise argparse.ArgumentTypeError(f"{text} is no rate: {why}")
    return value


def finite(text: str) -> float:
    """An argument's type: a finite number."""
    value = float(text)
    if not math.isfinite(value):
        raise argparse.ArgumentTypeError(f"{text} is not a finite number")
    return value


def share(text: str) -> float:
    """An argument's type: a share above 0."""
    value = float(text)
    if not 0.0 < value <= 1.0:
        raise argparse.ArgumentTypeError(f"{text} is not above 0 and at most 1")
    return value


def port(text: str) -> int:
    """An argument's type: a port to serve at; 0 for any that is free."""
    value = int(text)
    if not 0 <= value < 2**16:
        raise argparse.ArgumentTypeError(f"{text} is not between 0 and 65535")
    return value
