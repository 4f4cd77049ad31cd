"""Where measurements are kept: files of one line of JSON each."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

__all__ = ["append"]


def append(file: Path, row: Mapping[str, Any]) -> None:
    """Write `row` as the last line of `file`, which is made, and its folder, if there is none."""
    file.parent.mkdir(parents=True, exist_ok=True)
    with file.open("a", encoding="utf-8") as lines:
        lines.write(json.dumps(row) + "\n")
