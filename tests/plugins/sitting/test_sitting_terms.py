"""Rewards and terminations: eq. 2 to 8 with numbers."""

from __future__ import annotations

import math

import pytest
import torch

from understudy.setup.composition import load_experiment
from understudy.setup.config import Experiment
from understudy.task import Context
from understudy_sitting import terms


def context(decision: int = 1) -> Context:
    return Context(
        seed=0, device=torch.device("cpu"), num_worlds=1, control_dt=1 / 60, substeps=4,
        decision=decision,
    )  # fmt: skip


def weights(experiment: Experiment) -> dict[str, float]:
    return {t.name: t.extras["weight"] for t in experiment.many("reward.terms")}


def options(experiment: Experiment) -> dict[str, dict[str, float]]:
    return {t.name: dict(t.options or {}) for t in experiment.many("termination.terms")}


def test_constants_of_sections_4_and_6() -> None:
    walk, turn, sit = (
        load_experiment([f"experiment=sitting/{n}"]) for n in ("walk", "turn_left", "sit")
    )
    shared = {"pose": 0.5, "velocity": 0.05}
    assert weights(walk) == {**shared, "steering": 0.5, "approach": 0.1}
    assert weights(turn) == {**shared, "turning": 0.5}  # the paper's: 0.1
    assert weights(sit) == {**shared, "nearing": 0.5}
    assert options(walk)["low"] == {"height": 0.78}
    assert options(turn) == {"low": {"height": 0.78}, "off_course": {"degrees": 45.0}}
    assert options(sit)["low"] == {"height": 0.54}
    (target,) = walk.many("memory")
    assert target.options.every == 2.5
    for experiment in (walk, turn, sit):
        control = experiment.root.control
        assert (control.frequency, control.frequency * control.substeps) == (60.0, 240.0)
        policy = experiment.need("policy").options
        assert policy.hidden == (64, 64)
        last = 0.05 if experiment is turn else 0.3  # the paper's is fixed for turns too
        assert (policy.noise.start, policy.noise.end) == (0.3, last)


def test_similarity_of_poses_wraps_angles() -> None:
    joints = torch.zeros(3, 21)
    other = torch.zeros(3, 21)
    other[1, :2] = 0.1
    other[2, 0] = 2 * math.pi - 0.5
    found = terms.pose(joints, other)
    assert found.tolist() == pytest.approx([1.0, math.exp(-0.02), math.exp(-0.25)])
    assert terms.velocity(joints, other / 10)[1].item() == pytest.approx(math.exp(-10 * 2e-4))


def test_steering_ends_with_the_first_stage() -> None:
    velocity, reference = torch.tensor([[1.0, 0.0, 0.0]] * 2), torch.tensor([[1.2, 0.0, 0.1]] * 2)
    stage = torch.tensor([0.0, 1.0])
    found = terms.steering(velocity, reference, stage, until=1.0)
    assert found.tolist() == pytest.approx([math.exp(-10 * 0.05), 0.0])


def test_approach_is_a_logistic_function_of_speed() -> None:
    approach = terms.Approach(terms.Approach.Options(), context())
    before = torch.zeros(3, 3)
    after = torch.tensor([[0.0, 0, 5], [0.01, 0, 5], [-0.01, 0, 5]])  # its height does not count
    found = approach(after, before, torch.tensor([[2.0, 0.0]] * 3), torch.ones(3))
    speed = 0.01 * 60
    assert found.tolist() == pytest.approx(
        [0.5, 1 / (1 + math.exp(-10 * speed)), 1 / (1 + math.exp(10 * speed))], abs=1e-5
    )


def test_turning_and_leaving_the_course() -> None:
    angles = torch.tensor([[0.0, math.pi - 0.1, 0.0], [0.1, 0.0, 0.2], [0.0, 1.0, 0.0]])
    reference = torch.tensor([[0.0, -math.pi + 0.1, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 0.0]])
    found = terms.turning(angles, reference)
    assert found.tolist() == pytest.approx(
        [math.exp(-0.4), math.exp(-0.5), math.exp(-10)], rel=1e-4
    )
    assert terms.off_course(angles, reference).tolist() == [False, False, True]
    assert terms.low(torch.tensor([[0, 0, 0.77], [0, 0, 0.79]])).tolist() == [True, False]


def test_meta_reward_of_eq_8() -> None:
    reward = terms.SitDown(terms.SitDown.Options(), context(decision=30))
    found = reward(
        torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.2, 1.0, 2.0]), torch.tensor([0.3, 2.0, 1.0])
    )
    assert found.tolist() == pytest.approx([1.0, 0.5 * 1.0 / 0.5, -0.5 * 1.0 / 0.5])
    nearing = terms.Nearing(None, context())
    assert nearing(torch.tensor([0.9]), torch.tensor([1.0])).item() == pytest.approx(6.0, rel=1e-4)
