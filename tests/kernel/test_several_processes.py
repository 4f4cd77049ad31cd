"""Two processes, as ``torchrun`` starts them: what one decides holds for both, and a refusal of one
does not leave the other waiting."""

from __future__ import annotations

import json
import os
import socket
import subprocess
from pathlib import Path

import pytest
from commands import forked_together

pytest.importorskip("torch.distributed")

#: Begins a child's code: the command line with the line's parts. ``RANK`` says which one it is.
CLI = """
import os, sys, counted_task as c
from understudy.setup import plugins, composition
from understudy_training import workflow
found = c.line_plugins()
for module in (plugins, composition, workflow):
    module.installed = lambda: found
from understudy.command.cli import main
rank = int(os.environ["RANK"])
"""


def free_port() -> int:
    with socket.socket() as server:
        server.bind(("127.0.0.1", 0))
        return server.getsockname()[1]


def together(tmp_path: Path, code: str, *arguments: str) -> list[subprocess.CompletedProcess[str]]:
    """Both processes' ends; neither may take more than two minutes."""
    shared = {"MASTER_ADDR": "127.0.0.1", "MASTER_PORT": str(free_port()), "WORLD_SIZE": "2"}
    shared |= {"GLOO_SOCKET_IFNAME": "lo"}
    ranks = [{"RANK": str(rank), "LOCAL_RANK": str(rank), **shared} for rank in range(2)]
    return forked_together(CLI + code, *arguments, cwd=tmp_path, environments=ranks)


TRAIN = "sys.exit(main(['train', *c.LINE_TASK, 'budget.samples=32', *sys.argv[1:], *extra]))"


@pytest.mark.parametrize("refusing", [0, 1])
def test_one_that_refuses_makes_both_refuse(tmp_path: Path, refusing: int) -> None:
    code = f"""
def refuse(self):
    from understudy.errors import ConfigError
    raise ConfigError('No room here.')
if rank == {refusing}:
    from understudy_reinforcement.job import Reinforcement
    Reinforcement.prepare = refuse
extra = []
"""
    ends = together(tmp_path, code + TRAIN, "run.dir=run")
    assert [end.returncode for end in ends] == [2, 2], [end.stderr for end in ends]
    assert "understudy: No room here." in ends[refusing].stderr
    told = "understudy: Another process could not start; its own message says why."
    assert told in ends[1 - refusing].stderr
    assert not any("Traceback" in end.stderr for end in ends)


def test_two_train_as_one(tmp_path: Path) -> None:
    """Process 0 alone writes; both count samples; worlds are of one stream."""
    ends = together(tmp_path, "extra = []\n" + TRAIN, "run.dir=run", "initial_states.count=1000")
    assert [end.returncode for end in ends] == [0, 0], [end.stderr for end in ends]
    assert ends[0].stdout.splitlines()[-1] == "run: run"
    assert ends[1].stdout == ""
    rows = [json.loads(line) for line in (tmp_path / "run/metrics.jsonl").read_text().splitlines()]
    assert [row["samples"] for row in rows] == [16, 32]
    assert os.listdir(tmp_path) == ["run"]
