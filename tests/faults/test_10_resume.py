"""Fault 10: 2N iterations equal N, save, new process, resume, N — to the last bit."""

from __future__ import annotations

import copy
import os
import sys
from pathlib import Path

import pytest
import torch
from commands import begin_code, forked, kill, wait_for
from worlds import CLI, PADDLE_TASK, SMALL, assert_same_state, make_training, resumed

from understudy.random import WorldStreams
from understudy.records import checkpoint
from understudy.setup.plugins import Plugins, hookimpl, load
from understudy.setup.registry import Registrar
from understudy.task import Context, InitialStates, Rollout, State
from understudy.testing import fake
from understudy.testing.fake import FAKE_TASK

OVERRIDES = {"fake": (*FAKE_TASK, "episode.seconds=0.7"), "contacts": PADDLE_TASK}
N = 6

RESUME = """
import sys, worlds
training = worlds.resumed(worlds.all_plugins(), worlds.Path(sys.argv[1]))
for _ in range(int(sys.argv[2])):
    training.iterate()
training.save()
"""


@pytest.mark.parametrize("task", OVERRIDES)
def test_bitwise_in_a_new_process(plugins: Plugins, tmp_path: Path, task: str) -> None:
    overrides = [*OVERRIDES[task], *SMALL, "+policy.noise={start: 0.4, end: 0.1, samples: 1500}"]
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
    done = forked(RESUME, str(tmp_path / "cut"), str(N), cwd=tmp_path)
    assert done.returncode == 0, done.stderr
    state, _ = checkpoint.load(tmp_path / f"cut/checkpoints/{2 * N:08d}")
    own = straight.state_dict()
    assert own["learner"]["actor"]["0"]["exp_avg"].abs().sum() > 0
    assert_same_state(state, own)


class Widening(InitialStates):
    """Within a reach that grows with the steps learned from; each episode remembers its own."""

    episode_fields = {"reach": ()}

    def __init__(self, options: None, context: Context) -> None:
        self.reach = torch.full((), 0.1)

    def sample(self, streams: WorldStreams, **fields: torch.Tensor) -> dict[str, torch.Tensor]:
        qpos = (streams.uniform(1) * 2 - 1) * self.reach
        reach = self.reach.expand(len(qpos)).clone()
        return {"qpos": qpos, "qvel": torch.zeros_like(qpos), "reach": reach}

    def update(self, rollout: Rollout) -> dict[str, float]:
        self.reach += 0.01 * float(rollout.rewards.mean())
        return {"reach": float(self.reach)}

    def state_dict(self) -> State:
        return {"reach": self.reach.clone()}

    def load_state_dict(self, state: State) -> None:
        self.reach.copy_(state["reach"])


def beyond_reach(qpos: torch.Tensor, reach: torch.Tensor) -> torch.Tensor:
    """Further than where the episode can have begun."""
    return qpos.abs().squeeze(1) > 1.1 * reach


@hookimpl
def understudy_register(register: Registrar) -> None:
    register.component("initial_states", "widening", Widening)
    register.component("termination", "beyond_reach", beyond_reach)


def test_what_was_adapted_goes_on(tmp_path: Path) -> None:
    """The learning rate, what initial states learned, and what episodes under way began with."""
    plugins = load(extra=[("fake", fake), ("widening", sys.modules[__name__])])
    overrides = (
        *FAKE_TASK[:-2],
        "+initial_states={name: widening}",
        "+termination.terms.beyond={name: beyond_reach}",
        *SMALL,
        "+learner.target_kl=1e-4",
        "+policy.noise={start: 3.0, end: 3.0, samples: 1500}",
    )
    straight = make_training(plugins, overrides)
    rows = [straight.iterate() for _ in range(2 * N)]
    assert len({row["actor_learning_rate"] for row in rows}) > 2
    assert len({row["initial_states/reach"] for row in rows}) > 2
    first = make_training(plugins, overrides, tmp_path / "cut")
    for _ in range(N):
        first.iterate()
    reaches = first.job.environment._constants["reach"]
    assert len(set(reaches.tolist())) > 1, "episodes began at different times"
    first.save()
    assert first.run is not None
    first.run.unlock()
    again = resumed(plugins, tmp_path / "cut")
    for row in rows[N:]:
        found = again.iterate()
        for name in ("actor_learning_rate", "initial_states/reach", "reward", "episode/unsound"):
            assert found[name] == row[name], name
    assert_same_state(straight.state_dict(), again.state_dict())


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
    overrides = [*FAKE_TASK, *SMALL, "budget.samples=7680", "checkpoint.minutes=0"]
    straight = make_training(plugins, overrides)
    straight.train()
    run = tmp_path / "run"
    words, nowhere = ["train", *overrides, f"run.dir={run}"], Path(os.devnull)
    child = begin_code(
        f"{CLI}sys.exit(main(sys.argv[1:]))", *words, cwd=tmp_path, out=nowhere, err=nowhere
    )
    wait_for(child, run / "checkpoints/00000020.json")
    kill(child)
    again = resumed(plugins, run)
    assert 20 <= again.progress.iteration < 60
    again.train()
    assert_same_state(straight.state_dict(), again.state_dict())
    assert again.run is not None
    assert [row["iteration"] for row in again.run.metrics()] == list(range(1, 61))
