"""Each miniature trains, continues exactly, and would never wait for a GPU in a step."""

from __future__ import annotations

import time
from pathlib import Path

import pytest
import torch
from miniatures import JOBS, TRAININGS, overrides_of
from on_gpu import rollouts_without_waiting
from waits import NoWaits
from worlds import assert_same_state

from understudy.running.training import Training
from understudy.setup.composition import load_experiment
from understudy.testing import check_environment, check_simulator
from understudy_reinforcement.job import Reinforcement

torch.set_num_threads(1)


def made(name: str, built_on: Path, *more: str) -> Training:
    return Training(load_experiment([*overrides_of(name, built_on), *more])).prepare()


def learning(training: Training) -> Reinforcement:
    assert isinstance(training.job, Reinforcement)
    return training.job


@pytest.mark.parametrize("name", TRAININGS)
def test_conforms(name: str, built_on: Path) -> None:
    environment = learning(made(name, built_on, "num_worlds=4")).environment
    check_environment(environment)
    check_simulator(environment.parts.simulator, 4)


@pytest.mark.parametrize("name", [*TRAININGS, *JOBS])
def test_trains_quickly_and_continues_exactly(name: str, built_on: Path) -> None:
    """At its default size; by a training that went elsewhere before."""
    training = made(name, built_on)
    began = time.process_time()
    for _ in range(2):
        row = training.iterate()
    assert time.process_time() - began < 2
    assert row["samples"] >= 512
    assert all(value == value for value in row.values()), row
    if name == "sleeve_bank":
        return  # it is finished
    other = made(name, built_on)
    for _ in range(3):
        other.iterate()
    other.load_state_dict(training.state_dict())
    assert training.iterate().keys() == other.iterate().keys()
    assert_same_state(training.state_dict(), other.state_dict())


@pytest.mark.parametrize("name", TRAININGS)
def test_a_step_waits_for_nothing_and_keeps_its_tensors(name: str, built_on: Path) -> None:
    job = learning(made(name, built_on, "num_worlds=4"))
    environment, policy = job.environment, job.policy
    simulator = environment.parts.simulator

    def addresses() -> list[int]:
        lasting = [simulator.read(name) for name in simulator.fields]
        lasting += environment._tensors().values()
        return [value.data_ptr() for value in lasting]

    before, ended = addresses(), torch.tensor([True, False, True, False])
    with torch.no_grad(), NoWaits():
        for _ in range(3):
            action = policy.distribution(environment.observations).sample(job.collector.streams)
            environment.advance(action)
            environment.begin(ended)
    assert addresses() == before


def test_waiting_is_found() -> None:
    value = torch.arange(3)
    with NoWaits():
        value + 1
        for wait in (
            lambda: bool(value.any()), lambda: value[value > 1], lambda: torch.tensor([1.0]),
            lambda: value.nonzero(), lambda: float(value[0]),
        ):  # fmt: skip
            with pytest.raises(AssertionError, match="would wait"):
                wait()


@pytest.mark.slow
@pytest.mark.parametrize("name", TRAININGS)
def test_learns(name: str, built_on: Path) -> None:
    """In its own budget the return rises by a third of what it was and more."""
    training = made(name, built_on)
    before = training.job.evaluate("before", 64).measures["return"]
    training.train()
    after = training.job.evaluate("after", 64).measures["return"]
    assert after.low > before.high + abs(before.mean) / 3


@pytest.mark.gpu
@pytest.mark.parametrize("name", TRAININGS)
def test_trains_on_a_gpu_without_waiting(name: str, built_on: Path) -> None:
    """Steps are captured, and torch raises at any operation in a rollout that waits."""
    training = made(name, built_on, "device=cuda")
    rollouts_without_waiting(training)
    learning(training).evaluate("test", 8)


@pytest.mark.gpu
@pytest.mark.parametrize("name", JOBS)
def test_jobs_run_on_a_gpu(name: str, built_on: Path) -> None:
    training = made(name, built_on, "device=cuda")
    for _ in range(3):
        row = training.iterate()
    assert all(value == value for value in row.values()), row
