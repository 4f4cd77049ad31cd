"""Sweeps that die between two rows of their journal."""

from __future__ import annotations

from pathlib import Path

from commands import forked

#: Carries the sweep out and dies when row `after` of the journal is written.
_KILLED = """
import os, sys
import torch
torch.set_num_threads(1)
from understudy.command.cli import main
from understudy_sweeps import sweep as module
folder, after, *overrides = sys.argv[1:]

def dying(write):
    def written(self, event):
        write(self, event)
        if len(self.events) == int(after):
            os._exit(9)
    return written

module.Journal.ask = dying(module.Journal.ask)
module.Journal.tell = dying(module.Journal.tell)
main(["sweep", *overrides, f"run.dir={folder}"])
"""


def die_after(count: int, folder: Path, *overrides: str) -> None:
    """Carry the sweep of these overrides out in `folder`, in a process of its own that dies when row
    `count` of the journal is written."""
    folder.mkdir(parents=True, exist_ok=True)
    died = forked(_KILLED, str(folder), str(count), *overrides, cwd=folder.parent)
    assert died.returncode == 9, died.stderr
