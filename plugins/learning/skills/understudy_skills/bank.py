"""Banks: states in which episodes of one run ended, for episodes of another to begin in."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from torch import Tensor

from understudy.errors import FileError, RunError
from understudy.records import checkpoint

__all__ = ["files", "load"]

#: The bank that a harvest leaves in its run folder.
NAME = "bank"


def save(path: Path, states: Mapping[str, Tensor], about: Mapping[str, Any]) -> None:
    """Write `states`, fields (M, …) by name, and where they come from, as the bank `path`."""
    checkpoint.save(path, {"states": dict(states)}, {"bank": dict(about)})


def files(path: str | Path) -> list[Path]:
    """The files of a bank, given by one of them or by the run folder that has it."""
    file = Path(path) / NAME if Path(path).is_dir() else Path(path)
    return [file.with_suffix(".json"), file.with_suffix(".safetensors")]


def load(path: str | Path) -> dict[str, Tensor]:
    """The states of a bank, (M, …) by name: of its file, or of the run folder that has it.

    Raises
    ------
    FileError
        if it is missing, damaged, empty, or no bank.
    """
    try:
        state, _ = checkpoint.load(files(path)[0])
    except RunError as error:
        raise FileError(f"The bank {path} cannot be used: {error}") from error
    states = state.get("states")
    if not isinstance(states, dict) or not all(isinstance(v, Tensor) for v in states.values()):
        raise FileError(f"{path} is no bank of states.")
    lengths = {len(v) if v.dim() else 0 for v in states.values()}
    if len(lengths) != 1 or 0 in lengths:
        raise FileError(f"The bank {path} has no states, or not equally many of each field.")
    return states
