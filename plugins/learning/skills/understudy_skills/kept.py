"""The files that a run keeps of another one whose learned parts it uses."""

from __future__ import annotations

from pathlib import Path

from understudy.records import checkpoint, runs

__all__ = ["files_of"]


def files_of(run: str) -> list[Path]:
    """The ``run.json`` and the newest checkpoint of the run folder `run`, which :meth:`Inputs.file` keeps.

    Raises
    ------
    RunError
        if it is no run folder.
    """
    newest = checkpoint.newest(runs.open_run(run).checkpoints)[:1]
    parts = [part.with_suffix(end) for part in newest for end in (".json", ".safetensors")]
    return [Path(run) / "run.json", *parts]
