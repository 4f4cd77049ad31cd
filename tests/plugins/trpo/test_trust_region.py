"""TRPO on the line: it learns, keeps its limit, goes on exactly, skips what is not finite."""

from __future__ import annotations

from typing import Any

import pytest
import torch
from line_task import SIDE_AND_STEP, STEP, Line, line_context, make_policy, train
from worlds import assert_same_state

from understudy.errors import ConfigError, TrainingError
from understudy.setup.plugins import Plugins
from understudy.task import ActionSpace
from understudy.testing import check_plugin
from understudy_networks.nn import Schedule
from understudy_networks.policies import MLPPolicy
from understudy_trpo.learner import TRPO

STEPS = 16


def test_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("trpo", plugins)


def make(space: ActionSpace = STEP, learn_noise: bool = False, **options: Any) -> tuple[Line, TRPO]:
    context = line_context(space)
    chosen = MLPPolicy.Options(hidden=(32,), noise=Schedule(0.5, 0.5), learn_noise=learn_noise)
    policy = make_policy(MLPPolicy, chosen, context)
    learner = TRPO(TRPO.Options(**{"rollout_steps": STEPS, **options}), context, policy)
    return Line(context, policy), learner


@pytest.mark.parametrize(
    ("space", "options"),
    [
        pytest.param(STEP, {}, id="box"),
        pytest.param(SIDE_AND_STEP, {}, id="hybrid"),
        pytest.param(STEP, {"learn_noise": True, "fisher_share": 0.2}, id="learned-noise"),
    ],
)
def test_learns_to_stay_near(space: ActionSpace, options: dict[str, Any]) -> None:
    line, learner = make(space, value_epochs=3, **options)
    rows = train(line, learner.update, STEPS, 25)
    assert sum(row["reward"] for row in rows[:2]) / 2 < 0.55
    assert sum(row["reward"] for row in rows[-2:]) / 2 > 0.8
    assert all(row["skipped_steps"] == 0 for row in rows)
    assert max(row["kl"] for row in rows) <= learner.options.kl_limit
    assert all(row["gain"] > 0 for row in rows if row["step_share"])
    assert sum(row["step_share"] > 0 for row in rows) >= 20


@pytest.mark.parametrize("limit", [1e-4, 1e-2])
def test_a_step_uses_its_limit(limit: float) -> None:
    """Without damping the first step's divergence, measured afresh, is the limit or a little less."""
    line, learner = make(kl_limit=limit, damping=1e-5, conjugate_gradient_steps=30)
    rollout = line.collect(STEPS)
    before = line.policy.distribution(rollout.observations).map(torch.Tensor.detach)
    row = learner.update(rollout)
    with torch.no_grad():
        found = float(before.divergence(line.policy.distribution(rollout.observations)).mean())
    assert found == pytest.approx(row["kl"], rel=1e-3)
    assert 0.3 * limit < found <= limit
    assert row["gain"] > 0


def test_goes_on_exactly() -> None:
    line, learner = make()
    train(line, learner.update, STEPS, 2)
    other_line, other = make()
    other.load_state_dict(learner.state_dict())
    other_line.policy.load_state_dict(line.policy.state_dict())
    rollouts = [line.collect(STEPS) for _ in range(2)]
    assert [learner.update(r) for r in rollouts] == [other.update(r) for r in rollouts]
    assert_same_state(learner.state_dict(), other.state_dict())
    assert_same_state(line.policy.state_dict(), other_line.policy.state_dict())


def test_a_step_that_is_not_finite_changes_nothing() -> None:
    line, learner = make()
    dumped: list[Any] = []
    learner.on_fault = dumped.append
    before = {k: v.clone() for k, v in line.policy.state_dict().items()}
    bad = line.collect(STEPS)
    bad.rewards[3, 5] = float("nan")
    assert learner.update(bad)["skipped_steps"] >= 1 + 8  # one of eight batches holds the number
    actor = [k for k in before if k.startswith("actor")]
    assert all(torch.equal(before[k], line.policy.state_dict()[k]) for k in actor)
    assert all(torch.isfinite(v).all() for v in line.policy.state_dict().values())
    assert len(dumped) == 1
    assert learner.update(line.collect(STEPS))["skipped_steps"] == 0
    bad = line.collect(STEPS)
    bad.rewards[:] = float("inf")
    for _ in range(2):
        learner.update(bad)
    with pytest.raises(TrainingError, match=r"^3 updates in a row"):
        learner.update(bad)


def test_nothing_to_improve_is_no_fault() -> None:
    """Advantages of zero give a gradient of zero: the policy stays, nothing is skipped."""
    line, learner = make(gamma=0.0, gae_lambda=0.0)
    torch.nn.init.zeros_(list(line.policy.critic_parameters())[-2])
    rollout = line.collect(STEPS)
    rollout.rewards.zero_()
    before = [p.detach().clone() for p in line.policy.actor_parameters()]
    row = learner.update(rollout)
    assert row["skipped_steps"] == 0
    assert row["step_share"] == 0
    after = list(line.policy.actor_parameters())
    assert all(torch.equal(a, b) for a, b in zip(before, after, strict=True))


def test_refuses_a_batch_that_the_iteration_does_not_hold() -> None:
    with pytest.raises(ConfigError, match=r"value_batch_size=5000 is more than .* = 1024"):
        make(value_batch_size=5000)


@pytest.mark.parametrize(("steps", "given", "batches"), [(16, None, 8), (16, 64, 16), (256, None, 64), (256, 128, 128), (1, None, 1)])  # fmt: skip
def test_an_epoch_of_the_critic_has_at_most_64_steps_unless_asked(
    steps: int, given: int | None, batches: int
) -> None:
    """Of 64 worlds: 1 024 samples in batches of 128 as ever; 16 384 in 64 batches and not in 128; 64 in one."""
    _, learner = make(value_batch_size=given, rollout_steps=steps)
    parts = list(learner._minibatches(torch.zeros(steps * 64)))
    assert len(parts) == batches
    assert sorted(torch.cat(parts).tolist()) == list(range(steps * 64))
