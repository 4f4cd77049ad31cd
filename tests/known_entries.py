"""The entry points of plugins are looked for once a process, where nothing but this tree and its environment is on Python's
path, whose packages no test changes: reading those of all of them takes most of the time in which plugins load.
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


@functools.cache
def _once(path: tuple[str, ...], named: tuple[tuple[str, Any], ...]) -> metadata.EntryPoints:
    return real(**dict(named))


def found(**named: Any) -> Any:
    """As :func:`importlib.metadata.entry_points`."""
    path = tuple(sys.path)
    if named and all(folder.startswith(_OURS) for folder in path):
        return _once(path, tuple(sorted(named.items())))
    return real(**named)


def use() -> None:
    """From here on, in this process and its forks."""
    metadata.entry_points = found
