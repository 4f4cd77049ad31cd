"""Fault 10: 2N iterations equal N, save, new process, resume, N — to the last bit."""

from __future__ import annotations

import copy
import signal
import subprocess
import sys
import time
from pathlib import Path

import pytest
from worlds import (
    CLI,
    PADDLE_TASK,
    SMALL,
    assert_same_state,
    child_environment,
    make_training,
    python,
    resumed,
)

from understudy.records import checkpoint
from understudy.setup.plugins import Plugins
from understudy.testing.fake import FAKE_TASK

TASKS = {"fake": (*FAKE_TASK, "episode.seconds=0.7"), "contacts": PADDLE_TASK}
N = 6

RESUME = """
import sys, worlds
training = worlds.resumed(worlds.all_plugins(), worlds.Path(sys.argv[1]))
for _ in range(int(sys.argv[2])):
    training.iterate()
training.save()
"""


@pytest.mark.parametrize("task", TASKS)
def test_bitwise_in_a_new_process(plugins: Plugins, tmp_path: Path, task: str) -> None:
    overrides = [*TASKS[task], *SMALL, "+policy.noise={start: 0.4, end: 0.1, samples: 1500}"]
    straight = make_training(plugins, overrides, tmp_path / "straight")
    for _ in range(2 * N):
        straight.iterate()
    first = make_training(plugins, overrides, tmp_path / "cut")
    for _ in range(N):
        first.iterate()
    assert (first.job.environment.episode_step > 0).any(), "the cut is in the middle of episodes"
    first.save()
    assert first.run is not None
    first.run.unlock()
    done = python(RESUME, str(tmp_path / "cut"), str(N), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    state, _ = checkpoint.load(tmp_path / f"cut/checkpoints/{2 * N:08d}")
    own = straight.state_dict()
    assert own["learner"]["actor"]["0"]["exp_avg"].abs().sum() > 0
    assert_same_state(state, own)


def test_saving_changes_nothing(plugins: Plugins, tmp_path: Path) -> None:
    one = make_training(plugins, [*PADDLE_TASK, *SMALL])
    two = make_training(plugins, [*PADDLE_TASK, *SMALL], tmp_path / "run")
    for _ in range(4):
        one.iterate(), two.iterate()
        two.save()
    assert_same_state(one.state_dict(), two.state_dict())


def test_loading_replaces_everything(plugins: Plugins) -> None:
    """Into a training that went elsewhere before: nothing of its own past is left."""
    overrides = [*PADDLE_TASK, *SMALL]
    one, two = make_training(plugins, overrides), make_training(plugins, overrides)
    for _ in range(3):
        one.iterate()
    for _ in range(5):
        two.iterate()
    two.load_state_dict(copy.deepcopy(one.state_dict()))
    assert_same_state(one.state_dict(), two.state_dict(), ignore=())
    for _ in range(3):
        one.iterate(), two.iterate()
    assert_same_state(one.state_dict(), two.state_dict())


def test_killed_training_ends_with_the_same_weights(plugins: Plugins, tmp_path: Path) -> None:
    """SIGKILL in the middle of a training command, at two moments; resuming ends where one ends
    that was never stopped, with every metrics row once."""
    overrides = [*FAKE_TASK, *SMALL, "budget.samples=20480", "checkpoint.minutes=0"]
    straight = make_training(plugins, overrides)
    straight.train()
    run = tmp_path / "run"
    command = [sys.executable, "-c", CLI + "sys.exit(main(sys.argv[1:]))"]
    child = subprocess.Popen(
        [*command, "train", *overrides, f"run.dir={run}"],
        cwd=tmp_path, env=child_environment(), stderr=subprocess.DEVNULL,
    )  # fmt: skip
    deadline = time.monotonic() + 60
    while not (run / "checkpoints/00000020.json").exists() and time.monotonic() < deadline:
        assert child.poll() is None
        time.sleep(0.01)
    child.send_signal(signal.SIGKILL)
    child.wait()
    again = resumed(plugins, run)
    assert 20 <= again.progress.iteration < 160
    again.train()
    assert_same_state(straight.state_dict(), again.state_dict())
    assert again.run is not None
    assert [row["iteration"] for row in again.run.metrics()] == list(range(1, 161))
