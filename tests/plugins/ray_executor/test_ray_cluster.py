"""A sweep on a cluster of three nodes, which are processes of this machine: one node is killed, one is slow,
and the driver is killed and the command given again; its table is that of a sweep in one process."""

from __future__ import annotations

import csv
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from executors import SMALL_STOP, state_of
from killed_sweeps import rows
from worlds import assert_same_state, child_environment

pytest.importorskip("ray", reason="ray is not installed (the extra 'ray')")

from ray.cluster_utils import Cluster

from understudy.command.cli import main

pytestmark = [pytest.mark.slow, pytest.mark.timeout(900)]

SEEDS = range(1, 6)
SWEEP = (
    "sweep", *SMALL_STOP, "outer_loop=grid", f"outer_loop.seeds={list(SEEDS)}".replace(" ", ""),
    "budget.samples=4096", "evaluation.every_samples=1024", "run.video_seconds=0",
)  # fmt: skip


@pytest.fixture
def cluster() -> Iterator[Any]:
    made = Cluster()
    store: dict[str, Any] = {"object_store_memory": 100 * 2**20}
    made.add_node(num_cpus=1, include_dashboard=False, **store)
    for _ in range(2):
        made.add_node(num_cpus=1, **store)
    made.wait_for_nodes(timeout=120)
    yield made
    made.shutdown()


def drive(address: str, folder: Path) -> subprocess.Popen[str]:
    options = [f"executor.address='{address}'", "executor.retries=5", f"run.dir={folder}"]
    return subprocess.Popen(
        [sys.executable, "-m", "understudy", *SWEEP, "executor=ray", *options],
        env=child_environment(OMP_NUM_THREADS="1"), text=True,
        stdout=subprocess.DEVNULL, stderr=subprocess.PIPE,
    )  # fmt: skip


def under_way(folder: Path) -> int:
    """Iterations that trials have made."""
    return sum(p.read_text().count("\n") for p in folder.glob("*/metrics.jsonl"))


def wait_for(folder: Path, iterations: int, driver: subprocess.Popen[str]) -> None:
    deadline = time.monotonic() + 240
    while under_way(folder) < iterations:
        assert driver.poll() is None, driver.communicate()[1]
        assert time.monotonic() < deadline, "nothing goes on"
        time.sleep(0.05)


def raylet_of(node: Any) -> int:
    return node.all_processes["raylet"][0].process.pid


def below(process: int) -> list[int]:
    """The processes that it began, of Ray its workers."""
    try:
        found = Path(f"/proc/{process}/task/{process}/children").read_text().split()
    except OSError:
        return []
    return [number for child in map(int, found) for number in (child, *below(child))]


def has_a_trial(node: Any) -> bool:
    """Ray calls a worker by what it carries."""
    titles = (Path(f"/proc/{number}/cmdline") for number in below(raylet_of(node)))
    return any(b"Carrier" in title.read_bytes() for title in titles if title.exists())


def table(folder: Path) -> dict[str, dict[str, str]]:
    """What is told of each trial, less how long it took."""
    with open(folder / "trials.csv", encoding="utf-8") as file:
        found = list(csv.DictReader(file))
    return {r["trial"]: {k: v for k, v in r.items() if k != "seconds"} for r in found}


def test_a_node_is_killed_one_is_slow_and_the_driver_is_killed(
    cluster: Any, tmp_path: Path
) -> None:
    straight, folder = tmp_path / "straight", tmp_path / "cluster"
    assert main([*SWEEP, "executor=in_process", f"run.dir={straight}"]) == 0
    _, lost, slow = [cluster.head_node, *cluster.worker_nodes]
    driver = drive(cluster.address, folder)
    wait_for(folder, 12, driver)
    deadline = time.monotonic() + 60
    while not (has_a_trial(lost) and has_a_trial(slow)):
        assert time.monotonic() < deadline, "there is nothing to lose on these nodes"
        time.sleep(0.02)
    stopped = below(raylet_of(slow))
    for number in stopped:
        os.kill(number, signal.SIGSTOP)
    time.sleep(3.0)
    for number in stopped:
        os.kill(number, signal.SIGCONT)
    cluster.remove_node(lost, allow_graceful=False)
    wait_for(folder, under_way(folder) + 20, driver)
    driver.kill()
    driver.communicate()
    finished = sum(r["event"] == "finished" for r in rows(folder))
    assert finished < len(SEEDS), "it was stopped before its end"
    again = drive(cluster.address, folder)
    _, errors = again.communicate(timeout=400)
    assert again.returncode == 0, errors
    assert table(folder) == table(straight)
    for seed in SEEDS:
        key = f"base/seed{seed}"
        assert_same_state(state_of(straight, key), state_of(folder, key))
    told = [r["event"] for r in rows(folder)]
    assert (told.count("asked"), told.count("finished")) == (len(SEEDS), len(SEEDS))
