"""Reading a clip of any format: the content decides which reader reads it, never the file's name.

A reader is a component of kind ``clip_reader``, so that a plugin can add a format.
"""

from __future__ import annotations

import hashlib
from abc import ABC, abstractmethod
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal

from understudy.errors import FileError
from understudy.registry import Registry
from understudy_motion.clip import Clip

Unit = Literal["m", "cm", "mm", "inch", "foot"]
Axis = Literal["y", "z"]

METRES: Mapping[str, float] = {"m": 1.0, "cm": 0.01, "mm": 0.001, "inch": 0.0254, "foot": 0.3048}
HEAD_BYTES = 4096
MAX_BYTES = 64 * 2**20


@dataclass(frozen=True)
class ReadOptions:
    """What a file may leave unsaid. None: taken from the file, or recognised, or an error that asks."""

    unit: Unit | None = None  #: of lengths
    up: Axis | None = None  #: the vertical axis
    skeleton: Path | None = None  #: the skeleton's own file, for formats that keep it apart (ASF)
    loop: bool | None = None  #: whether the motion repeats, where the format does not say


UNSAID = ReadOptions()
"""Options of a file that says everything."""


class ClipReader(ABC):
    """Reads one format."""

    #: Usual endings of such files, for lists of clips; they decide nothing.
    suffixes: tuple[str, ...] = ()

    @abstractmethod
    def recognises(self, head: bytes) -> bool:
        """Whether a file that begins with `head` (at most :data:`HEAD_BYTES`) is of this format."""

    @abstractmethod
    def read(self, path: Path, options: ReadOptions = UNSAID) -> Clip:
        """Read and check the clip.

        Raises:
            FileError: missing, too large, damaged, or not a motion; the message names the file and,
                where there is one, the line or frame (from 0) and the field.
        """


def readers(registry: Registry) -> dict[str, ClipReader]:
    """By format name: the readers of all plugins."""
    return {
        name: registry.find("clip_reader", name).factory() for name in registry.names("clip_reader")
    }


def read_clip(path: Path, registry: Registry, options: ReadOptions = UNSAID) -> Clip:
    """Read the clip file at `path`, whatever its format.

    Raises:
        FileError: no reader recognises it, or as :meth:`ClipReader.read`.
    """
    head = read_bytes(path, HEAD_BYTES, whole=False)
    known = readers(registry)
    for reader in known.values():
        if reader.recognises(head):
            return reader.read(path, options)
    formats = ", ".join(known) or "none"
    raise FileError(f"Clip {path}: not a format that is read here ({formats}).{registry.absent()}")


def read_bytes(path: Path, limit: int = MAX_BYTES, *, whole: bool = True) -> bytes:
    """The file's content, at most `limit` bytes; more is an error if the `whole` file is wanted.

    Raises:
        FileError: missing, unreadable, or larger than `limit`.
    """
    try:
        if not path.is_file():
            raise FileError(f"Clip {path}: there is no such file.")
        with path.open("rb") as file:
            content = file.read(limit + 1)
    except (OSError, ValueError) as error:
        raise FileError(f"Clip {path}: cannot be read: {error}.") from error
    if whole and len(content) > limit:
        raise FileError(f"Clip {path}: larger than {limit // 2**20} MB.")
    return content[:limit]


def provenance(path: Path, content: bytes) -> dict[str, Any]:
    """The fields of :class:`Clip` that say where a file's motion comes from."""
    return {
        "source": str(path),
        "licence": licence_beside(path),
        "sha256": hashlib.sha256(content).hexdigest(),
    }


def licence_beside(path: Path) -> str:
    """The first line of a LICENSE file beside the clip, if there is one."""
    try:
        with path.with_name("LICENSE").open(encoding="utf-8", errors="replace") as file:
            first = next((line.strip() for line in file if line.strip()), "")
    except OSError:
        return "unknown"
    return f"{first[:200]}; see LICENSE beside the clip" if first else "unknown"
