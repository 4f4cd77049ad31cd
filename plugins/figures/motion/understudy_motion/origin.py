"""Where a file's motion comes from, and under which licence: its record, or a LICENSE file beside it."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING, Any

from understudy.errors import FileError
from understudy_motion.limits import read_bytes

if TYPE_CHECKING:
    from understudy_motion.clip import Clip

__all__ = ["RECORD_SUFFIX", "terms_of", "without_folder"]

RECORD_SUFFIX = ".provenance.json"
LICENCE = "LICENSE"
MAX_RECORD_BYTES = 2**16
MAX_RECORD_LINE = 2000
MAX_LICENCE_BYTES = 2**16


def provenance(path: Path, content: bytes) -> dict[str, Any]:
    """The fields of :class:`Clip` that say where a file's motion comes from.

    They are those of the clip's licence record if it is a record of this very `content`; else the
    licence is that of a LICENSE file beside the clip.
    """
    digest = hashlib.sha256(content).hexdigest()
    record = read_record(path)
    if record.get("sha256") != digest:
        record = {}
    return {
        "source": str(path),
        "licence": record.get("licence") or licence_beside(path),
        "sha256": digest,
        "url": record.get("url", ""),
        "attribution": record.get("attribution", ""),
    }


def without_folder(source: str) -> str:
    """The `source` of a clip as files say it that others get: of a path from the root of a disk, or from a home, its name."""
    path = source.replace("\\", "/")
    outright = path.startswith(("/", "~", "../")) or path[1:3] == ":/"
    return (path.rstrip("/").rpartition("/")[2] or source) if outright else source


def record_path(path: Path) -> Path:
    """Where the licence record of the clip at `path` is: beside it, under its stem."""
    return path.with_name(path.stem + RECORD_SUFFIX)


def read_record(path: Path) -> dict[str, str]:
    """The texts of the licence record of the clip at `path`, each a printable line.

    Its keys are ``clip``, ``url``, ``date``, ``sha256`` and, where known, ``licence`` and
    ``attribution``. Empty if there is no record, or none that can be read.
    """
    try:
        record = json.loads(read_bytes(record_path(path), MAX_RECORD_BYTES))
    except (FileError, ValueError, RecursionError):
        return {}
    if not isinstance(record, dict):
        return {}
    return {
        key: "".join(filter(str.isprintable, value))[:MAX_RECORD_LINE]
        for key, value in record.items()
        if isinstance(value, str)
    }


def terms_of(clips: Iterable[Clip]) -> list[dict[str, str]]:
    """Each of the `clips` once, with its licence and, where known, its address and acknowledgement, as a run records of what
    it learned from several."""
    rows = [
        {
            "clip": c.name,
            "licence": c.licence,
            "url": c.url or "",
            "attribution": c.attribution or "",
        }
        for c in clips
    ]
    kept = [{key: text for key, text in row.items() if text} for row in rows]
    return [row for at, row in enumerate(kept) if row not in kept[:at]]


def licence_beside(path: Path) -> str:
    """The first line of a LICENSE file beside the clip, if there is one."""
    try:
        text = read_bytes(path.with_name(LICENCE), MAX_LICENCE_BYTES, whole=False).decode(
            errors="replace"
        )
    except FileError:
        return "unknown"
    first = next((line.strip() for line in text.splitlines() if line.strip()), "")
    return f"{first[:200]}; see LICENSE beside the clip" if first else "unknown"
