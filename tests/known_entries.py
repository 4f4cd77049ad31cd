"""The entry points of what is installed in this environment are read once a process, since no test changes its packages:
reading those of all of them takes most of the time in which plugins load. Folders of tests on Python's path are read each time.
"""

from __future__ import annotations

import functools
import sys
from importlib import metadata
from pathlib import Path
from typing import Any

#: Below which no test installs or changes a package.
_OURS = (str(Path(__file__).resolve().parents[1]), sys.prefix, sys.base_prefix)
real = metadata.entry_points


def _in(folder: str, **named: Any) -> dict[str, metadata.EntryPoints]:
    """By name as packages are told apart: the entry points of each package in the folder."""
    return {
        package._normalized_name: package.entry_points.select(**named)  # type: ignore[attr-defined]
        for package in reversed([*metadata.distributions(path=[folder])])
    }


@functools.cache
def _kept(folder: str, named: tuple[tuple[str, Any], ...]) -> dict[str, metadata.EntryPoints]:
    return _in(folder, **dict(named))


def found(**named: Any) -> Any:
    """As :func:`importlib.metadata.entry_points`: of each package, those of the first folder that has it."""
    if not named:
        return real()
    key = tuple(sorted(named.items()))
    packages: dict[str, metadata.EntryPoints] = {}
    for folder in sys.path:
        there = _kept(folder, key) if folder.startswith(_OURS) else _in(folder, **named)
        packages = there | packages
    return metadata.EntryPoints(point for points in packages.values() for point in points)


def use() -> None:
    """From here on, in this process and its forks."""
    metadata.entry_points = found
