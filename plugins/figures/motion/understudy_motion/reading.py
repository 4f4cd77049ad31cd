"""Reading a clip of any format: the content decides which reader reads it, never the file's name.

What a file leaves unsaid (its unit, say) is asked for as ``motion.unit``, on the command line
``--unit``, and so on for every field of :class:`ReadOptions`.

A reader is a component of kind ``clip_reader``, so that a plugin can add a format.
"""

from __future__ import annotations

import math
import warnings
from abc import ABC, abstractmethod
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from understudy.errors import ConfigError, FileError, PluginError
from understudy.setup.registry import Registry
from understudy_motion.clip import Clip
from understudy_motion.limits import read_bytes

__all__ = ["SLOWEST_RATE", "Axis", "ReadOptions", "Unit", "metres_of", "readers"]

NamedUnit = Literal["m", "cm", "mm", "inch", "foot"]
Unit = NamedUnit | float
"""Of length: a name, or the metres in it."""
Axis = Literal["y", "z"]
AngleUnit = Literal["degrees", "radians"]

METRES: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}
HEAD_BYTES = 4096
SLOWEST_RATE = 1.0
"""Frames per second of a motion, at least."""
FASTEST_RATE = 10_000.0
"""And at most: high-speed cameras record people at 2000, robots log a motor at up to 10 000."""
LONGEST = 1e5
"""s that a clip lasts at most, a day and a bit."""


@dataclass(frozen=True)
class ReadOptions:
    """What a file may leave unsaid. None: taken from the file, or recognised, or an error that asks.

    Raises
    ------
    ConfigError
        a rate, or a unit in metres, that is not above zero.
    """

    unit: Unit | None = None  #: of lengths
    up: Axis | None = None  #: the vertical axis
    skeleton: Path | None = None  #: the skeleton's own file, for formats that keep it apart (ASF)
    loop: bool | None = None  #: whether the motion repeats, where the format does not say
    rate: float | None = None  #: frames per second, for formats whose frames have no times
    angles: AngleUnit | None = None  #: the unit of angles

    def __post_init__(self) -> None:
        if self.rate is not None and not 0.0 < self.rate < math.inf:
            raise ConfigError(
                f"motion.rate={self.rate} (--source-rate) is not possible: frames per second are above 0."
            )
        if self.rate is not None and (why := no_rate(self.rate)):
            raise ConfigError(f"motion.rate={self.rate} (--source-rate) is not possible: {why}.")
        if isinstance(self.unit, float | int) and not 0.0 < self.unit < math.inf:
            raise ConfigError(
                f"motion.unit={self.unit} (--unit) is not possible: the metres in a unit are above 0."
            )


def metres_of(unit: Unit) -> float:
    """Metres in a `unit` of length."""
    return METRES[unit] if isinstance(unit, str) else float(unit)


def no_rate(rate: float) -> str:
    """Why so many frames per second are none, empty if they may be: the seconds between two of them are often given."""
    if rate > FASTEST_RATE:
        return f"nothing that moves is recorded so often; if these are the µs between two, the rate is {1e6 / rate:.4g}"
    if rate >= SLOWEST_RATE:
        return ""
    apart = f"{1.0 / rate:.4g}"
    return f"frames would be {apart} s apart; if these are the seconds between two, the rate is {apart}"


PACKED = {
    b"\x1f\x8b": "gzip", b"BZh": "bzip2", b"\xfd7zXZ": "xz", b"7z\xbc\xaf": "7-Zip", b"Rar!": "RAR",
    b"\x28\xb5\x2f\xfd": "Zstandard", b"PK\x03\x04": "zip",
}  # fmt: skip
"""How packed files begin."""

PICKLES = (b"(dp", b"(lp", b"ccopy_reg\n", b"cnumpy", b"x\x01", b"x\x5e", b"x\x9c", b"x\xda")
"""How pickles of old programs begin, and such as joblib packs by zlib."""

OTHERS = {
    b"Kaydara FBX": ("an FBX file", "BVH"), b"; FBX": ("an FBX file", "BVH"), b"glTF": ("a glTF file", "BVH"),
    b"PAR1": ("a Parquet file", "CSV"), b"\xd0\xcf\x11\xe0": ("a spreadsheet", "CSV"),
}  # fmt: skip
"""What begins so, and what programs export in its place that is read here."""

_FIXED = {
    "unit": ("unit", "their unit of length"),
    "up": ("up", "which axis is vertical"),
    "rate": ("source-rate", "their times"),
    "skeleton": ("skeleton", "their skeleton, or have none"),
    "angles": ("angles", "the unit of their angles, or have none"),
}
"""Flag and words for what files may say."""

UNSAID = ReadOptions()
"""Options of a file that says everything."""


class UnknownFormatError(FileError):
    """No reader recognises the file."""


class ClipReader(ABC):
    """Reads one format."""

    #: What every file of the format says itself, by its name in :class:`ReadOptions`; another is refused.
    fixed: Mapping[str, Any] = {"skeleton": None, "angles": None}
    #: Usual endings of such files, for lists of clips; they decide nothing.
    suffixes: tuple[str, ...] = ()

    @abstractmethod
    def recognises(self, head: bytes, path: Path) -> bool:
        """Whether the file at `path`, which begins with `head`, is of this format.

        `head` is at most :data:`HEAD_BYTES`; the file itself is only opened by formats that share
        their beginning with others (zip archives). Never raises: a file that cannot be told is no.
        """

    @abstractmethod
    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        """Read and check the clip.

        Raises
        ------
        FileError
            missing, too large, damaged, or not a motion; the message names the file and,
            where there is one, the line or frame (from 0) and the field.
        """

    def needs(self, path: Path, options: ReadOptions) -> Sequence[Path]:
        """The files that reading `path` takes besides, other than those that `options` name.

        Raises
        ------
        FileError
            there is none of a kind that is needed.
        """
        return ()


def readers(registry: Registry) -> dict[str, ClipReader]:
    """By format name: the readers of all plugins."""
    return every(registry, "clip_reader", ClipReader)


def every(registry: Registry, kind: str, like: type) -> dict[str, Any]:
    """By name one of each component of the `kind`, as its interface `like` has it. What cannot be made is left out,
    and said where something is not found (:meth:`Registry.absent`)."""
    found = {}
    for name in registry.names(kind):
        component = registry.find(kind, name)
        try:
            with component.guarded("cannot be used"):
                found[name] = component.make(like)
        except PluginError as error:
            registry.broken[component.plugin] = str(error)
    return found


def read_clip(path: Path, registry: Registry, options: ReadOptions = UNSAID) -> Clip:
    """Read the clip file at `path`, whatever its format.

    Raises
    ------
    UnknownFormatError
        no reader recognises it.
    FileError
        as :meth:`ClipReader.read`.
    """
    reader = reader_of(path, registry)
    for name, own in reader.fixed.items():
        given = getattr(options, name)
        if given not in (None, own):
            flag, what = _FIXED[name]
            said = f"{what}, {own}" if own else what
            raise FileError(
                f"Clip {path}: files of this kind say {said}; leave motion.{name}={given} (--{flag}) out."
            )
    clip = reader.read(path, options)
    if (rate := 1.0 / float(clip.times.diff().median())) > FASTEST_RATE:
        raise FileError(
            f"Clip {path}: its frames are {1.0 / rate:.3g} s apart, {rate:.4g} a second, and nothing that moves is recorded "
            "so often. Write its times in seconds, or give motion.rate (--source-rate)."
        )
    if clip.duration > LONGEST:
        raise FileError(
            f"Clip {path}: it lasts {clip.duration:.4g} s, and nobody records longer than {LONGEST:g}. Write its times in seconds, or "
            "give motion.rate (--source-rate)."
        )
    if rate < SLOWEST_RATE:
        cure = f"motion.rate={1.0 / rate:.4g} (--source-rate) reads them so"
        cure = "write its times in seconds" if "rate" in reader.fixed else cure
        warnings.warn(
            f"Clip {path}: its frames are {1.0 / rate:.4g} s apart, and a motion has {SLOWEST_RATE:g} a second or more; if these "
            f"are frames per second, {cure}.",
            stacklevel=2,
        )
    return clip


def reader_of(path: Path, registry: Registry) -> ClipReader:
    """The reader that recognises the file at `path`; errors as :func:`read_clip`."""
    head = read_bytes(path, HEAD_BYTES, whole=False)
    known = readers(registry)
    for name, reader in known.items():
        if _recognised(registry, name, reader, head, path):
            return reader
    torch_s = head.startswith(b"PK") and b"/data.pkl" in head  # a zip with a pickle
    if head.startswith((b"\x80", *PICKLES)) or torch_s:
        raise UnknownFormatError(
            f"Clip {path}: a pickle, which could run any code when it is read, and is not. Save what it "
            "holds as a table or an NPZ where it was made (docs/motion.md): of a robot, its root's "
            "position, its quaternion as xyzw and its angles as the columns of a CSV, or as root_pos, root_rot, dof_pos and fps of an NPZ."
        )
    if not head:
        raise UnknownFormatError(f"Clip {path}: the file is empty.")
    if head.startswith(b"PK\x03\x04") and path.suffix.lower() == ".npz":
        raise UnknownFormatError(f"Clip {path}: {_of_archive(path)}{registry.absent()}")
    if head.startswith(b"\x93NUMPY"):
        raise UnknownFormatError(
            f"Clip {path}: one array without names. Save what it holds as a table or an NPZ (docs/motion.md)."
        )
    other = next((said for sign, said in OTHERS.items() if head.startswith(sign)), None)
    if head.startswith(b"PK") and b"[Content_Types].xml" in head:
        other = ("a spreadsheet", "CSV")
    if other:
        raise UnknownFormatError(
            f"Clip {path}: {other[0]}, which is not read here. Export it as {other[1]}."
        )
    packed = next((name for sign, name in PACKED.items() if head.startswith(sign)), None)
    if packed and (packed != "zip" or path.suffix.lower() == ".zip"):  # NPZ are zip, too
        raise UnknownFormatError(
            f"Clip {path}: packed by {packed}. Unpack it, and name the file within."
        )
    formats = ", ".join(known) or "none"
    raise UnknownFormatError(
        f"Clip {path}: not a format that is read here ({formats}).{registry.absent()}"
    )


def _recognised(registry: Registry, name: str, reader: ClipReader, head: bytes, path: Path) -> bool:
    """Whether the `reader` called `name` recognises the file. A stranger's that raises does not, and others are asked."""
    component = registry.find("clip_reader", name)
    if component.distribution == "understudy":
        return reader.recognises(head, path)
    try:
        with component.guarded("cannot be used"):
            return reader.recognises(head, path)
    except PluginError as error:
        registry.broken[component.plugin] = str(error)
        return False


def _of_archive(path: Path) -> str:
    """What is the matter with the NPZ at `path`, which no reader recognises."""
    from understudy_motion.readers.npz import Archive  # which reads by what is here

    try:
        names = sorted(Archive(path).names)[:12]
    except FileError:
        return (
            "a damaged NPZ, perhaps one that was not fetched to its end; fetch or export it again."
        )
    there = ", ".join(repr(name[:40]) for name in names) or "nothing"
    return (
        f"an NPZ of no kind that is read here. It has {there}; AMASS and its like have poses, trans and "
        "mocap_framerate. A robot's have root_pos, root_rot (xyzw), dof_pos, in the order of its model, and fps."
    )
