"""Finding a clip: by file, by the name of a generated one, or by name in the data folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path

from understudy.errors import FileError, suggestion
from understudy.registry import Component
from understudy_motion.clip import Clip
from understudy_motion.readers import deepmimic

DATA_VARIABLE = "UNDERSTUDY_DATA"
SUFFIXES = (".txt", ".json")


def data_folder() -> Path | None:
    """The folder that ``$UNDERSTUDY_DATA`` names, if it is there."""
    named = os.environ.get(DATA_VARIABLE)
    return Path(named) if named and Path(named).is_dir() else None


def load(
    name: str | None, file: str | None, generated: Mapping[str, Component] | None = None
) -> Clip:
    """The clip of a file, or the clip of a name.

    Args:
        generated: components that make clips, by name.
        name: a generated clip, else the stem of a file in ``motions/*`` of the data folder.
        file: path of a clip file; wins over ``name``.

    Raises:
        FileError: nothing is asked for, the name is not known, or the file is not a clip.
    """
    if file is not None:
        return deepmimic.read(Path(file))
    if not name:
        raise FileError("No motion clip: give motion.name=NAME or motion.file=PATH.")
    if "/" in name or "\\" in name or ".." in name:
        raise FileError(f"'{name}' is not a clip's name; for a file give motion.file=PATH.")
    generated = generated or {}
    if name in generated:
        return generated[name].factory()
    files = _files()
    if name in files:
        return deepmimic.read(files[name])
    raise FileError(
        f"No motion clip '{name}'.{suggestion(name, {*generated, *files})} Clip files are given as "
        f"motion.file=PATH or looked for in ${DATA_VARIABLE}/motions."
    )


def _files() -> dict[str, Path]:
    """Stem -> path of the data folder's clips; the first folder in alphabetical order wins."""
    folder = data_folder()
    if folder is None:
        return {}
    found: dict[str, Path] = {}
    for path in sorted(folder.glob("motions/*/*")):
        is_clip = path.suffix in SUFFIXES and not path.stem.endswith("character")
        if is_clip and path.is_file():
            found.setdefault(path.stem, path)
    return found
