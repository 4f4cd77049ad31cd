"""PPO on the line, under each of its options; its state; what it refuses."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from line_task import SIDE_AND_STEP, STEP, Line, line_context, make_policy, train
from worlds import assert_same_state

from understudy.errors import ConfigError, TrainingError
from understudy.options import make_options
from understudy.setup.plugins import Plugins
from understudy.task import ActionSpace
from understudy.testing import check_plugin
from understudy_networks.nn import Schedule
from understudy_networks.policies import MLPPolicy
from understudy_ppo.learner import PPO, RATE_STEP
from understudy_ppo.losses import KLPenalty, clipped_surrogate

STEPS = 16
ADAM = {"actor_learning_rate": 3e-3, "critic_learning_rate": 3e-3}
FAST = {"actor_learning_rate": 1.2e-2, "critic_learning_rate": 1.8e-2}
HELD_BACK = {"actor_learning_rate": 6e-3, "critic_learning_rate": 9e-3}
SGD = {
    "optimiser": "sgd",
    "momentum": 0.9,
    "actor_learning_rate": 3e-2,
    "critic_learning_rate": 3e-2,
}


def test_plugin_conforms(plugins: Plugins) -> None:
    check_plugin("ppo", plugins)


def make(
    options: dict[str, Any], space: ActionSpace = STEP, worlds: int = 64, **policy: Any
) -> tuple[Line, PPO]:
    context = line_context(space, worlds)
    chosen = {"hidden": (32,), "noise": Schedule(0.5, 0.5), **policy}
    made = make_policy(MLPPolicy, MLPPolicy.Options(**chosen), context)
    learner = PPO(PPO.Options(rollout_steps=STEPS, **options), context, made)
    return Line(context, made), learner


QUICK_SGD = SGD | {"actor_learning_rate": 5e-2, "critic_learning_rate": 5e-2}
PENALTY, MILD = {"clip": None, "kl_penalty": KLPenalty(100.0)}, {"kl_penalty": KLPenalty()}


@pytest.mark.parametrize(
    ("options", "space", "iterations"),
    [
        pytest.param(FAST, STEP, 8, id="clip"),
        pytest.param(FAST, SIDE_AND_STEP, 8, id="hybrid"),
        pytest.param(HELD_BACK | PENALTY, STEP, 15, id="penalty"),
        pytest.param(HELD_BACK | MILD, SIDE_AND_STEP, 15, id="clip-and-penalty"),
        pytest.param(FAST | {"minibatches": None, "batch_size": 100}, STEP, 8, id="batch-size"),
        pytest.param(FAST | {"precision": "bfloat16"}, STEP, 8, id="bfloat16"),
        pytest.param(FAST | {"weight_decay": 1e-3}, STEP, 8, id="weight-decay"),
        pytest.param(QUICK_SGD, STEP, 8, id="sgd"),
        pytest.param(FAST | {"td_lambda": 0.8, "entropy_weight": 1e-3}, STEP, 8, id="td-lambda"),
    ],
)
def test_learns_to_stay_near(options: dict[str, Any], space: ActionSpace, iterations: int) -> None:
    line, learner = make(options, space)
    rows = train(line, learner.update, STEPS, iterations)
    assert sum(row["reward"] for row in rows[:2]) / 2 < 0.55
    assert sum(row["reward"] for row in rows[-2:]) / 2 > 0.8  # 0.9 at best with this noise
    assert all(row["skipped_steps"] == 0 for row in rows)
    assert max(row["kl"] for row in rows) < 0.2
    assert max(row["explained_variance"] for row in rows) > 0.15


def test_first_step_ratio_is_one() -> None:
    """Old and new log-probabilities come from the same networks and normaliser."""
    line, learner = make({"epochs": 1, "minibatches": 1})
    for row in train(line, learner.update, STEPS, 3):
        assert abs(row["kl"]) < 1e-6
        assert row["clipped"] == 0


def test_bfloat16_acts_as_it_learns() -> None:
    """The first ratio is one to a few of bfloat16's roundings of the hidden units."""
    ratios = {}
    for acting in ("bfloat16", "float32"):
        line, _ = make({"precision": "bfloat16"}, hidden=(256, 128), noise=Schedule(0.05, 0.05))
        assert isinstance(line.policy, MLPPolicy)
        network = line.policy.actor
        torch.nn.init.normal_(network[-1].weight, 0.0, 0.1)  # type: ignore[arg-type]
        network.precision = acting
        rollout = line.collect(STEPS)
        network.precision = "bfloat16"
        seen = {k: v.flatten(0, 1) for k, v in rollout.observations.items()}
        new = line.policy.distribution(seen).log_prob(rollout.actions.flatten(0, 1))
        ratios[acting] = float((new.detach() - rollout.log_probs.flatten()).abs().mean())
    assert ratios["bfloat16"] < 1e-3
    assert ratios["float32"] > 10 * ratios["bfloat16"]


def test_bfloat16_needs_a_network_that_knows_it() -> None:
    line, _ = make({})
    line.policy.actor, line.policy.critic = torch.nn.Linear(2, 1), torch.nn.Linear(2, 1)  # type: ignore[assignment]
    with pytest.raises(ConfigError, match=r"no network that computes in bfloat16\. Use"):
        PPO(PPO.Options(precision="bfloat16"), line_context(), line.policy)


def test_learned_noise_changes_and_scheduled_noise_follows() -> None:
    line, learner = make(ADAM, learn_noise=True)
    train(line, learner.update, STEPS, 4)
    deviation = line.policy.state_dict()["log_deviation"].exp()
    assert float(deviation) != pytest.approx(0.5)
    line, learner = make(ADAM, noise=Schedule(0.5, 0.2, 2048))
    line.policy.schedule(4096)
    train(line, learner.update, STEPS, 1)
    assert float(line.policy.state_dict()["log_deviation"].exp()) == pytest.approx(0.2)


@pytest.mark.parametrize(
    "options",
    [
        pytest.param(ADAM | {"target_kl": 0.01, "kl_penalty": KLPenalty()}, id="adam"),
        pytest.param(SGD | {"clip": None, "kl_penalty": KLPenalty(3.0)}, id="sgd"),
        pytest.param(ADAM | {"minibatches": None, "batch_size": 60}, id="batch-size"),
    ],
)
def test_goes_on_exactly(options: dict[str, Any]) -> None:
    """From a state, the next updates equal those of the learner that never stopped."""
    line, learner = make(options)
    train(line, learner.update, STEPS, 3)
    other_line, other = make(options)
    other.load_state_dict(learner.state_dict())
    assert_same_state(learner.state_dict(), other.state_dict())
    other_line.policy.load_state_dict(line.policy.state_dict())
    rollouts = [line.collect(STEPS) for _ in range(2)]
    ours = [learner.update(rollout) for rollout in rollouts]
    theirs = [other.update(rollout) for rollout in rollouts]
    assert ours == theirs
    assert_same_state(learner.state_dict(), other.state_dict())
    assert_same_state(line.policy.state_dict(), other_line.policy.state_dict())


def test_the_rate_follows_the_divergence() -> None:
    """From a rate that is far too low and one that is far too high, into the target's range."""
    for rate in (1e-5, 3e-2):
        line, learner = make(ADAM | {"actor_learning_rate": rate, "target_kl": 0.01})
        rows = train(line, learner.update, STEPS, 16)
        late = [row["kl"] for row in rows[-8:]]
        assert 0.003 < sum(late) / len(late) < 0.03
        assert rows[-1]["actor_learning_rate"] != pytest.approx(rate, rel=0.1)


def test_the_penalty_brings_the_divergence_to_its_target() -> None:
    """From a coefficient that is far too high."""
    line, learner = make(ADAM | {"clip": None, "kl_penalty": KLPenalty(1e3, target=0.01)})
    rows = train(line, learner.update, STEPS, 16)
    assert rows[0]["divergence"] < 0.003
    assert rows[0]["kl_coefficient"] == 1e3
    assert rows[1]["kl_coefficient"] == 500.0
    middle = [row["divergence"] for row in rows[10:16]]
    assert 0.004 < sum(middle) / len(middle) < 0.04
    strong, weak = (
        train(*_parts(make(ADAM | {"clip": None, "kl_penalty": KLPenalty(c)})), STEPS, 1)[0]
        for c in (1e3, 1e-3)
    )
    assert strong["divergence"] < weak["divergence"] / 10


def _parts(made: tuple[Line, PPO]) -> tuple[Line, Callable[..., dict[str, float]]]:
    return made[0], made[1].update


def test_the_penalty_adapts_as_published() -> None:
    penalty = KLPenalty(target=0.01)
    assert penalty.adapted(1.0, 0.0151) == 2.0
    assert penalty.adapted(1.0, 0.0066) == 0.5
    assert penalty.adapted(1.0, 0.01) == 1.0
    assert penalty.adapted(1.0, float("nan")) == 2.0


def test_surrogate() -> None:
    ratio, advantages = torch.tensor([1.5, 1.5, 0.5, 0.5]), torch.tensor([1.0, -1.0, 1.0, -1.0])
    assert float(clipped_surrogate(ratio, advantages, None)) == 0.0
    assert float(clipped_surrogate(ratio, advantages, 0.2)) == pytest.approx(
        (1.2 - 1.5 + 0.5 - 0.8) / 4
    )


@settings(max_examples=40, deadline=None)
@given(seed=st.integers(0, 10**6), clip=st.floats(0.01, 0.9))
def test_the_surrogate_and_its_gradient_are_as_published(seed: int, clip: float) -> None:
    """E[min(r A, clip(r, 1 - ε, 1 + ε) A)], as equation 7 writes it."""
    chance = torch.Generator().manual_seed(seed)
    advantages = torch.randn(64, generator=chance).double()
    ratio = torch.randn(64, generator=chance).double().exp()
    ours, theirs = ratio.clone().requires_grad_(), ratio.clone().requires_grad_()
    found = clipped_surrogate(ours, advantages, clip)
    written = torch.minimum(theirs * advantages, theirs.clamp(1 - clip, 1 + clip) * advantages)
    torch.testing.assert_close(found, written.mean())
    found.backward()
    written.mean().backward()
    torch.testing.assert_close(ours.grad, theirs.grad)


def test_gradient_descent_with_momentum_is_what_it_says() -> None:
    """v ← m v + g + d θ, θ ← θ - rate v, by hand for the critic's last bias."""
    rate, m, decay = 0.05, 0.9, 0.01
    line, learner = make(
        SGD | {"critic_learning_rate": rate, "weight_decay": decay, "epochs": 1, "minibatches": 1}
        | {"max_gradient_norm": 1e9}
    )  # fmt: skip
    bias = list(line.policy.critic_parameters())[-1]
    bias.data.fill_(0.3)
    v = torch.zeros(1)
    for _ in range(3):
        rollout, before = line.collect(STEPS), bias.detach().clone()
        values = line.policy.value(rollout.observations).detach()
        learner.update(rollout)
        assert rollout.returns is not None
        g = 2 * (values - rollout.returns).mean()
        v = m * v + g + decay * before
        torch.testing.assert_close(bias.detach(), before - rate * v, rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("options", [ADAM, SGD, ADAM | {"kl_penalty": KLPenalty()}])
def test_a_step_that_is_not_finite_changes_nothing(options: dict[str, Any]) -> None:
    """From the very first step on, when optimisers make their state."""
    line, learner = make(options | {"patience": 100})
    dumped: list[Any] = []
    learner.on_fault = dumped.append
    before = {k: v.clone() for k, v in line.policy.state_dict().items()}
    bad = line.collect(STEPS)
    bad.rewards[3, 5] = float("nan")
    assert learner.update(bad)["skipped_steps"] == 32
    assert_same_state(line.policy.state_dict(), before)
    assert len(dumped) == 1
    assert not torch.isfinite(learner.losses(dumped[0]).actor)
    row = learner.update(line.collect(STEPS))
    assert row["skipped_steps"] == 0
    assert all(torch.isfinite(v).all() for v in line.policy.state_dict().values())
    with pytest.raises(AssertionError):
        assert_same_state(line.policy.state_dict(), before)


def test_the_weight_of_the_critics_error() -> None:
    line, learner = make(SGD)
    _, halved = make(SGD | {"value_weight": 0.5})
    found: list[dict[str, torch.Tensor]] = []
    learner._step = lambda minibatch: found.append(dict(minibatch))  # type: ignore[method-assign,assignment]
    learner.update(line.collect(STEPS))
    whole, half = learner.losses(found[0]), halved.losses(found[0])
    torch.testing.assert_close(half.value, 0.5 * whole.value)
    assert torch.equal(half.actor, whole.actor)


def test_advantages_are_clipped() -> None:
    largest = []
    for clip in (None, 0.5):
        line, learner = make(ADAM | {"advantage_clip": clip})
        found: list[float] = []
        learner._step = lambda m, found=found: found.append(float(m["advantages"].abs().max()))  # type: ignore[method-assign,assignment]
        learner.update(line.collect(STEPS))
        largest.append(max(found))
    assert largest[0] > 1
    assert largest[1] == 0.5


def test_patience() -> None:
    _, learner = make({"patience": 40})
    line, _ = make({})
    bad = line.collect(STEPS)
    bad.rewards[0, 0] = float("inf")
    learner.update(bad)
    with pytest.raises(TrainingError, match=r"^64 optimiser steps in a row had a non-finite"):
        learner.update(bad)


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"batch_size": 64}, "minibatches=8 with batch_size=64 .* exactly one"),
        ({"minibatches": None}, "minibatches=None with batch_size=None .* exactly one"),
        ({"clip": None}, "clip=null is not possible without kl_penalty"),
        ({"momentum": 0.9}, "momentum=0.9 is not possible: it needs optimiser=sgd"),
        ({"kl_penalty": {"target": 0}}, r"kl_penalty\.target=0.* must be greater than 0"),
        ({"optimiser": "adan"}, "Did you mean 'adam'"),
    ],
)
def test_refuses(options: dict[str, Any], message: str) -> None:
    with pytest.raises(ConfigError, match=message):
        make_options(PPO.Options, options, "learner")


def test_refuses_batches_that_the_iteration_does_not_hold() -> None:
    with pytest.raises(ConfigError, match=r"batch_size=2000 is more than .* = 1024"):
        make({"minibatches": None, "batch_size": 2000})
    with pytest.raises(ConfigError, match="minibatches=2000 are more than"):
        make({"minibatches": 2000})
    assert RATE_STEP > 1


def test_batch_size_takes_whole_batches() -> None:
    """1024 samples in batches of 100: ten steps an epoch."""
    line, learner = make({"minibatches": None, "batch_size": 100, "epochs": 3})
    bad = line.collect(STEPS)
    bad.rewards[:] = float("nan")
    with pytest.raises(TrainingError, match=r"^30 optimiser steps"):
        learner.update(bad)


def test_side_by_side_gives_what_one_after_the_other_gives() -> None:
    """On two threads actor and critic are updated at once."""
    weights = []
    before = torch.get_num_threads()
    try:
        for threads in (1, 2):
            torch.set_num_threads(threads)
            line, learner = make(ADAM)
            train(line, learner.update, STEPS, 2)
            assert torch.get_num_threads() == threads
            weights.append(dict(line.policy.named_parameters()))
    finally:
        torch.set_num_threads(before)
    for name, value in weights[0].items():
        torch.testing.assert_close(value, weights[1][name], rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", ["actor_rate", "kl_coefficient", "updates"])
def test_a_state_with_a_rate_below_0_is_refused(name: str) -> None:
    """What went on from it went uphill without a word."""
    _, learner = make(ADAM)
    with pytest.raises(ValueError, match=f"'{name}' is -1, below 0"):
        learner.load_state_dict({**learner.state_dict(), name: -1.0})


def test_the_critic_learns_first() -> None:
    """An actor that came without its critic stays as it is until values mean something, also over a pause."""
    options = ADAM | MILD | {"critic_first": 3, "target_kl": 0.02}
    line, learner = make(options)
    actor = [p.clone() for p in line.policy.actor_parameters()]
    critic = [p.clone() for p in line.policy.critic_parameters()]
    rows = train(line, learner.update, STEPS, 2)
    assert [row["actor_learning_rate"] for row in rows] == [0.0, 0.0]
    assert rows[1]["kl_coefficient"] == KLPenalty().coefficient, "nothing to adapt it by"
    other, paused = make(options)
    other.policy.load_state_dict(line.policy.state_dict())
    paused.load_state_dict(learner.state_dict())
    (third,) = train(other, paused.update, STEPS, 1)
    assert third["actor_learning_rate"] == 0
    assert all(map(torch.equal, actor, other.policy.actor_parameters()))
    assert not any(map(torch.equal, critic, other.policy.critic_parameters()))
    (fourth,) = train(other, paused.update, STEPS, 1)
    assert fourth["actor_learning_rate"] > 0
    assert not any(map(torch.equal, actor, other.policy.actor_parameters()))


def test_checkpoints_of_before_do_not_begin_with_the_critic_anew() -> None:
    line, learner = make(ADAM | {"critic_first": 3})
    learner.load_state_dict({k: v for k, v in learner.state_dict().items() if k != "updates"})
    (row,) = train(line, learner.update, STEPS, 1)
    assert row["actor_learning_rate"] > 0
