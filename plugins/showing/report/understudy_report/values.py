"""Values of a run's files, which may be missing, damaged or of any type."""

from __future__ import annotations

import functools
import json
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from understudy.command.command import tell
from understudy.folders import read
from understudy.records.runs import Run

__all__ = ["Row", "interval", "mapping", "number", "own_evaluation", "read_evaluation", "sequence"]

Row = Mapping[str, Any]


def read_evaluation(run: Run) -> Row:
    """The last evaluation; empty if there is none, and, which is said once, if it cannot be read."""
    file = run.path / "evaluation.json"
    try:
        found = json.loads(read(file))
    except FileNotFoundError:
        return {}
    except (OSError, ValueError, RecursionError):
        found = None
    if not isinstance(found, Mapping):
        _say_unreadable(file)
    return mapping(found)


@functools.cache
def _say_unreadable(file: Path) -> None:
    tell(
        f"{file} cannot be read, so the run counts as not judged. `understudy evaluate` judges it anew."
    )


def mapping(value: Any) -> Mapping[str, Any]:
    """`value`, or an empty mapping where it is none."""
    return value if isinstance(value, Mapping) else {}


def sequence(value: Any) -> Sequence[Any]:
    """`value`, or an empty sequence where it is none."""
    return value if isinstance(value, list | tuple) else []


def own_evaluation(run: Run) -> Row:
    """The last evaluation of the run as it was trained; empty where the last was of something else."""
    evaluation = read_evaluation(run)
    return {} if evaluation.get("changed") else evaluation


def number(value: Any) -> float | None:
    """`value` as a number that can be drawn, if it is one."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        return None
    return float(value) if abs(value) < 1e30 else None  # false for NaN too


def interval(value: Any) -> tuple[float, float] | None:
    """`value` as the two ends of an interval, if it is one."""
    match [number(end) for end in sequence(value)]:
        case [float(low), float(high)]:
            return low, high
    return None
