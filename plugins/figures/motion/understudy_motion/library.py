"""Finding a clip: by file, by the name of a generated one, or by name in the data folder."""

from __future__ import annotations

import os
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from understudy.errors import ConfigError, FileError, suggestion
from understudy.inputs import Inputs
from understudy.options import checked_options
from understudy.setup.registry import Registry
from understudy_motion.clip import Clip
from understudy_motion.origin import LICENCE, RECORD_SUFFIX, record_path
from understudy_motion.reading import UNSAID, ReadOptions, read_clip, reader_of, readers

__all__ = ["data_folder", "find", "kept"]

DATA_VARIABLE = "UNDERSTUDY_DATA"


def data_folder() -> Path | None:
    """The folder that ``$UNDERSTUDY_DATA`` names, if it is there."""
    named = os.environ.get(DATA_VARIABLE)
    return Path(named) if named and Path(named).is_dir() else None


def load(
    name: str | None,
    file: str | None,
    registry: Registry,
    parameters: Mapping[str, Any] | None = None,
    options: ReadOptions = UNSAID,
) -> Clip:
    """The clip of a file, or the clip of a name.

    Parameters
    ----------
    name
        a generated clip, else the stem of a file in ``motions/*`` of the data folder, else of
        the working folder.
    file
        path of a clip file; wins over ``name``.
    registry
        where generated clips and readers are found.
    parameters
        of a generated clip (its speed, say).
    options
        how a file is read.

    Raises
    ------
    FileError
        nothing is asked for, the name is not known, or the file is not a clip.
    ConfigError
        a parameter that the generated clip does not have, or parameters for a file.
    """
    if file is None and name in registry.names("clip"):
        for option, value in vars(options).items():
            if value is not None:
                raise ConfigError(
                    f"motion.{option}={value} is of clip files, and {name} is generated. Leave it out."
                )
        component = registry.find("clip", name)
        return component.call(
            **checked_options(component.options, parameters or {}, "motion.parameters")
        )
    if parameters:
        raise ConfigError(
            f"motion.parameters={dict(parameters)!r} is not possible: only generated clips have them."
            f"{suggestion('', registry.names('clip'))}"
        )
    return read_clip(_file(name, file, registry), registry, options)


def files(
    name: str | None, file: str | None, registry: Registry, options: ReadOptions = UNSAID
) -> list[Path]:
    """The file of a clip that is not generated, then those beside it that are read with it.

    Raises
    ------
    FileError
        as :func:`load`.
    """
    path = _file(name, file, registry)
    beside = (record_path(path), path.with_name(LICENCE))
    needed = reader_of(path, registry).needs(path, options)
    return [path, *needed, *(p for p in beside if p.is_file() and not p.is_symlink())]


def _file(name: str | None, file: str | None, registry: Registry) -> Path:
    if file is not None:
        if not Path(file).name:  # empty, as where a variable of the shell is
            raise FileError(
                f"motion.file='{file}' names no file. Give the path of a clip, or leave it out."
            )
        return Path(file)
    if not name:
        raise FileError("No motion clip: give motion.name=NAME or motion.file=PATH.")
    if "/" in name or "\\" in name or ".." in name:
        raise FileError(f"'{name}' is not a clip's name; for a file give motion.file=PATH.")
    known = _files(tuple(s for reader in readers(registry).values() for s in reader.suffixes))
    if name in known:
        return known[name]
    wrong = os.environ.get(DATA_VARIABLE)
    wrong = f" {DATA_VARIABLE}={wrong} is no folder." if wrong and data_folder() is None else ""
    raise FileError(
        f"No motion clip '{name}'.{suggestion(name, {*registry.names('clip'), *known})}{wrong} Clip files "
        f"are given as motion.file=PATH or looked for in ${DATA_VARIABLE}/motions and in motions, where "
        "`understudy motion fetch` puts published ones."
    )


def find(source: str, registry: Registry, options: ReadOptions = UNSAID) -> Clip:
    """The clip that `source` is the path or the name of.

    Raises
    ------
    FileError
        as :func:`load` and :func:`read_clip`.
    """
    if _is_path(source):
        return read_clip(Path(source), registry, options)
    return load(source, None, registry, options=options)


def kept(source: str, registry: Registry, inputs: Inputs) -> Clip:
    """As :func:`find`; the run keeps a copy of its file and reads that from then on.

    Raises
    ------
    RunError
        the copy is not what the run was made with.
    """
    name, file = (None, source) if _is_path(source) else (source, None)
    if name in registry.names("clip"):
        return load(name, None, registry)
    return read_clip(inputs.file(f"clip {source}", lambda: files(name, file, registry)), registry)


def _is_path(source: str) -> bool:
    path = Path(source)
    return path.is_file() or bool(path.suffix) or len(path.parts) > 1


def _files(suffixes: tuple[str, ...]) -> dict[str, Path]:
    """Stem -> path of the clips of the data folder, then of the working folder; of each the first folder
    in alphabetical order wins."""
    found: dict[str, Path] = {}
    folders = [folder for folder in (data_folder(), Path()) if folder is not None]
    for path in (path for folder in folders for path in sorted(folder.glob("motions/*/*"))):
        beside = path.stem.endswith("character") or path.name.endswith(RECORD_SUFFIX)
        if path.suffix in suffixes and not beside and path.is_file():
            found.setdefault(path.stem, path)
    return found
