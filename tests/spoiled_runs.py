"""Copies of runs whose newest checkpoint is whole, and says something else."""

from __future__ import annotations

import shutil
from pathlib import Path
from typing import Any

from understudy.records import checkpoint


def spoiled(run: Path, folder: Path, **changes: Any) -> Path:
    """A copy of `run` in `folder` with `changes` of its state's entries; None takes one out."""
    shutil.copytree(run, folder)
    newest = checkpoint.newest(folder / "checkpoints")[0]
    state, meta = checkpoint.load(newest)
    state = {key: value for key, value in {**state, **changes}.items() if value is not None}
    checkpoint.save(newest, state, meta)
    return folder
