"""Feedforward plus feedback: what the policy of figure 3.4 adds up."""

from __future__ import annotations

import pytest
import torch
from torch import Tensor

from understudy.errors import ConfigError
from understudy.task import Context, box
from understudy_networks.policies import MLPPolicy
from understudy_spacetime.policy import FeedforwardFeedback

OPTIONS = FeedforwardFeedback.Options(feedback=MLPPolicy.Options(hidden=(16,)))


def observations(worlds: int = 6) -> dict[str, Tensor]:
    chance = torch.Generator().manual_seed(0)
    shapes = {"state": 5, "feedforward": 28}
    return {name: torch.randn(worlds, size, generator=chance) for name, size in shapes.items()}


def test_mean_is_the_reference_pose_plus_the_networks_offset(context: Context) -> None:
    policy, seen = FeedforwardFeedback(OPTIONS, context), observations()
    with torch.no_grad():
        whole, offset = policy.distribution(seen), policy.feedback.distribution(seen)
    torch.testing.assert_close(whole.mean, seen["feedforward"] + offset.mean)
    assert torch.equal(whole.std.expand_as(whole.mean), offset.std.expand_as(whole.mean))
    assert torch.equal(whole.mode(), whole.mean)
    assert whole.mean.shape == (6, 28)
    assert policy.value(seen).shape == (6,)


def test_a_fresh_policy_plays_nearly_the_reference(context: Context) -> None:
    policy, seen = FeedforwardFeedback(OPTIONS, context), observations()
    assert (policy.distribution(seen).mean - seen["feedforward"]).abs().max() < 0.1


def test_the_reference_pose_is_neither_normalised_nor_learned(context: Context) -> None:
    policy, seen = FeedforwardFeedback(OPTIONS, context), observations(500)
    policy.observe({**seen, "state": 10.0 + 3.0 * seen["state"]})
    shifted = {**seen, "feedforward": seen["feedforward"] + 1.0}
    difference = policy.distribution(shifted).mean - policy.distribution(seen).mean
    torch.testing.assert_close(difference, torch.ones_like(difference))
    learned = {id(p) for p in (*policy.actor_parameters(), *policy.critic_parameters())}
    network = {
        id(p) for p in (*policy.feedback.actor.parameters(), *policy.feedback.critic.parameters())
    }
    assert learned == network


def test_a_missing_encoder_says_what_to_add(context: Context) -> None:
    context.observation_shapes = {"state": (5,), "feedfoward": (28,)}
    message = (
        r"policy 'spacetime/feedforward_feedback' needs the observation 'feedforward', which no "
        r"encoder of this task provides\. Add encoder\.feedforward=.*Did you mean 'feedfoward'"
    )
    with pytest.raises(ConfigError, match=message):
        FeedforwardFeedback(OPTIONS, context)
    context.observation_shapes = {"feedforward": (28,)}
    with pytest.raises(ConfigError, match="needs the observation 'state'"):
        FeedforwardFeedback(OPTIONS, context)


def test_an_action_that_is_no_joint_target_is_refused(context: Context) -> None:
    context.action_space = box(4)
    with pytest.raises(ConfigError, match="28 numbers and the action 4; choose an actuation"):
        FeedforwardFeedback(OPTIONS, context)
