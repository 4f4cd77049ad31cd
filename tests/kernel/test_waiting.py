"""Torch's threads leave the cores to the simulator's, and to other programs."""

from __future__ import annotations

import os
import subprocess
import sys

import pytest

from understudy.records.runs import cores

#: ``{first}`` is what a program imports first.
SPENT = """
import time
{first}
import torch
torch.set_num_threads(2)
numbers = torch.randn(4_000_000)
numbers.exp()
began = time.process_time()
time.sleep(0.1)
print(time.process_time() - began)
"""


def spent_waiting(first: str, **environment: str) -> float:
    """Seconds of CPU time that a process spends in 0.1 s of waiting after parallel work."""
    kept = {name: value for name, value in os.environ.items() if name != "OMP_WAIT_POLICY"}
    command = [sys.executable, "-c", SPENT.format(first=first)]
    result = subprocess.run(
        command, env=kept | environment, capture_output=True, text=True, check=True
    )
    return float(result.stdout)


@pytest.mark.skipif(cores() < 2, reason="one core has no second thread")
@pytest.mark.parametrize(
    "first", ["import understudy", "from understudy.setup.composition import load_experiment"]
)
def test_threads_that_helped_sleep_unless_they_are_told_to_spin(first: str) -> None:
    """The notebook imports the second: spinning beside other programs, its training took ten times as long."""
    assert spent_waiting(first) < 1e-3
    assert spent_waiting(first, OMP_WAIT_POLICY="ACTIVE") > 2e-3
