"""The runs that some of the miniatures build on."""

from __future__ import annotations

from pathlib import Path

import pytest
from miniatures import BUILT_ON, QUICK, train


@pytest.fixture(scope="session")
def built_on(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with the runs ``go``, ``stop``, ``sleeve``, ``bank`` and ``poses``, made by the
    command line."""
    folder = tmp_path_factory.mktemp("stages")
    for name, iterations in BUILT_ON.items():
        budget = f"budget.samples={1024 * iterations}"
        train(f"experiment=miniature/{name}", budget, *QUICK, f"run.dir={folder / name}")
    bank = (f"job.run={folder / 'sleeve'}", "job.count=64")
    train("experiment=miniature/sleeve_bank", *bank, *QUICK, f"run.dir={folder / 'bank'}")
    budget = "budget.samples=50000"
    train("experiment=miniature/poses", budget, *QUICK[:3], f"run.dir={folder / 'poses'}")
    return folder
