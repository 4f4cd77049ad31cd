"""Licences as somebody wrote them down beside what they are of."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from contextlib import suppress
from pathlib import Path

from understudy.folders import read

__all__ = ["beside", "named", "record_beside"]

#: How the file beside a clip ends that says where it is from.
_RECORD = ".provenance.json"
#: Names of files that hold a licence.
_LICENCE = re.compile(r"(licen[cs]e|copying)(\.(txt|md|rst))?", re.IGNORECASE)
#: Whole texts of licences, by a sentence that only they have; the first that is found counts.
_TEXTS = (
    (r"attribution-noncommercial-sharealike", "CC BY-NC-SA"),
    (r"attribution-noncommercial-noderiv", "CC BY-NC-ND"),
    (r"attribution-noncommercial", "CC BY-NC"),
    (r"attribution-noderiv", "CC BY-ND"),
    (r"attribution-sharealike", "CC BY-SA"),
    (r"creative commons attribution|attribution 4\.0 international", "CC BY"),
    (r"cc0 1\.0 universal|creative commons zero", "CC0"),
    (r"gnu affero general public license", "AGPL"),
    (r"gnu lesser general public license", "LGPL"),
    (r"gnu general public license", "GPL"),
    (r"mozilla public license", "MPL"),
    (r"apache license\s+version 2\.0", "Apache-2.0"),
    (r"permission is hereby granted, free of charge, to any person", "MIT"),
    (r"redistribution and use in source and binary forms", "BSD"),
    (r"this is free and unencumbered software", "Unlicense"),
)


def named(text: str) -> str:
    """The short name of the licence whose whole `text` is given, else its first line."""
    flat = " ".join(text.lower().split())
    for sign, name in _TEXTS:
        if re.search(sign, flat):
            return name
    return next((line.strip()[:200] for line in text.splitlines() if line.strip()), "unknown")


def beside(files: Iterable[Path]) -> str:
    """The licence among `files`, by its name where the text is a known one's; ``unknown`` if there is none."""
    for path in files:
        if _LICENCE.fullmatch(path.name):
            with suppress(OSError):
                return named(read(path, 2**20).decode("utf-8", "replace"))
    return "unknown"


def record_beside(files: Iterable[Path]) -> Mapping[str, object]:
    """What the record of a clip among `files` says of it; nothing if there is none."""
    for path in files:
        if path.name.endswith(_RECORD):
            with suppress(OSError, ValueError, RecursionError):
                found = json.loads(read(path, 2**16))
                return found if isinstance(found, Mapping) else {}
    return {}
