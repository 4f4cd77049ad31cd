"""Fault 17: the same seed gives the same bits, whatever else runs, watches or is installed."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest
import torch
from worlds import PADDLE_TASK, SMALL, assert_same_state, make_training

from understudy.random import WorldStreams
from understudy.records.observer import RunObserver
from understudy.records.runs import Run
from understudy.running.training import Reporter, Training
from understudy.setup.building import build_environment
from understudy.setup.composition import load_experiment
from understudy.setup.plugins import Plugins, load
from understudy.testing import fake
from understudy.testing.fake import FAKE_TASK

TASKS = {"fake": (*FAKE_TASK, "episode.seconds=0.7"), "contacts": PADDLE_TASK}


@pytest.fixture
def threads() -> Iterator[None]:
    before = torch.get_num_threads()
    yield
    torch.set_num_threads(before)


def trained(plugins: Plugins, *overrides: str, iterations: int = 4) -> Training:
    training = make_training(plugins, [*overrides])
    for _ in range(iterations):
        training.iterate()
    return training


@pytest.mark.parametrize("task", TASKS)
def test_same_seed_same_bits(plugins: Plugins, task: str) -> None:
    overrides = [*TASKS[task], *SMALL]
    one, two = trained(plugins, *overrides), trained(plugins, *overrides)
    assert_same_state(one.state_dict(), two.state_dict())
    three = trained(plugins, *overrides, "seed=1")
    with pytest.raises(AssertionError):
        assert_same_state(one.state_dict(), three.state_dict())


@pytest.mark.usefixtures("threads")
@pytest.mark.parametrize("count", [1, 2])
def test_an_equal_number_of_threads_gives_the_same_bits(plugins: Plugins, count: int) -> None:
    """Networks as large as the walk's, whose products torch splits between threads."""
    overrides = [
        *TASKS["contacts"],
        *SMALL,
        "num_worlds=256",
        "policy.hidden=[1024, 512]",
        "learner.epochs=1",
        f"simulator.threads={count}",
    ]
    torch.set_num_threads(count)
    one, two = (trained(plugins, *overrides, iterations=2).state_dict() for _ in range(2))
    assert_same_state(one, two)


@pytest.mark.usefixtures("threads")
def test_one_thread_of_the_simulator_equals_two(plugins: Plugins) -> None:
    """Whatever torch does, and in a small network torch's number does not matter either."""
    states = []
    for count in (1, 2):
        torch.set_num_threads(count)
        overrides = [*TASKS["contacts"], *SMALL, "num_worlds=256", f"simulator.threads={count}"]
        states.append(trained(plugins, *overrides, iterations=3).state_dict())
    assert_same_state(*states)


def test_streams_do_not_depend_on_the_number_of_worlds() -> None:
    few, many = (WorldStreams(3, "x", n, "cpu") for n in (4, 100))
    for _ in range(3):
        assert torch.equal(few.uniform(3), many.uniform(3)[:4])
        assert torch.equal(few.normal(5), many.normal(5)[:4])


@pytest.mark.parametrize("task", TASKS)
def test_worlds_do_not_depend_on_how_many_there_are(plugins: Plugins, task: str) -> None:
    """Episodes end at different times in different worlds; a world's next start is its own."""
    steps = []
    for count in (4, 16):
        overrides = [*TASKS[task], *SMALL, f"num_worlds={count}"]
        env = build_environment(load_experiment(overrides, plugins)).environment
        env.reset()
        env.episode_step += torch.arange(count)  # so that they end one after the other
        action = torch.linspace(-2, 2, count).unsqueeze(1).clone()
        action[:4] = torch.tensor([[-1.0], [0.5], [1.0], [2.0]])
        steps.append([env.step(action) for _ in range(45)])
    for few, many in zip(*steps, strict=True):
        assert torch.equal(few.observations["state"], many.observations["state"][:4])
        assert torch.equal(few.rewards, many.rewards[:4])
        assert torch.equal(few.truncated, many.truncated[:4])
    assert sum(int(s.truncated.sum()) for s in steps[0]) >= 8


def test_observers_change_nothing(plugins: Plugins, tmp_path: Path) -> None:
    class Nosy(RunObserver):
        rows = 0

        def iteration(self, run: Run, row: Mapping[str, float], stage: str) -> None:
            self.rows += 1
            torch.rand(3)

    states = []
    for number, observers in enumerate(([], [nosy := Nosy()])):
        training = make_training(
            plugins, [*TASKS["contacts"], *SMALL, "budget.samples=1024"],
            tmp_path / f"run{number}", Reporter(observers=observers),
        )  # fmt: skip
        training.train()
        states.append(training.state_dict())
    assert nosy.rows == 8
    assert_same_state(*states)


@pytest.mark.parametrize("task", TASKS)
def test_evaluating_in_between_changes_nothing(plugins: Plugins, task: str) -> None:
    failures = "far" if task == "fake" else "gone"
    overrides = [
        *TASKS[task],
        *SMALL,
        f"evaluation.failures=[{failures}]",
        "evaluation.seconds=0.5",
    ]
    one, two = make_training(plugins, overrides), make_training(plugins, overrides)
    found = []
    for _ in range(2):
        one.iterate(), two.iterate()
        found.append([two.job.evaluate("a", 5) for _ in range(2)])
    assert_same_state(
        one.state_dict(),
        two.state_dict(),
        ("/progress/seconds",),
    )
    assert all(first == second for first, second in found), "and an evaluation repeats exactly"


def test_other_plugins_change_nothing() -> None:
    """With only the plugin in use loaded, the bits are those with all of them loaded."""
    overrides = [*TASKS["fake"], *SMALL]
    one = trained(
        load(only=["networks", "ppo", "reinforcement"], extra=[("fake", fake)]), *overrides
    )
    two = trained(load(extra=[("fake", fake)]), *overrides)
    assert_same_state(one.state_dict(), two.state_dict())
