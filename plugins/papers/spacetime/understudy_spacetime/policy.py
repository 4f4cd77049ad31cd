"""The policy of figure 3.4: a feedforward controller plus a learned feedback controller."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field

from torch import Tensor, nn

from understudy.errors import ConfigError
from understudy.task import Context
from understudy_networks.nn import DiagonalGaussian
from understudy_networks.policies import MLPPolicy, observation_size
from understudy_reinforcement.policy import Policy


class FeedforwardFeedback(Policy):
    """PD targets q = q̂ + Δq: q̂ from the reference by phase, Δq from the network (figure 3.4)."""

    @dataclass(frozen=True)
    class Options:
        #: Name of the observation that holds q̂; null is one network without a feedforward controller.
        feedforward: str | None = "feedforward"
        feedback: MLPPolicy.Options = field(default_factory=MLPPolicy.Options)  #: the network of Δq

    def __init__(self, options: Options, context: Context) -> None:
        super().__init__()
        who = "policy 'spacetime/feedforward_feedback'"
        size = context.action_size
        if options.feedforward is not None:
            size = observation_size(context, options.feedforward, who)
        if size != context.action_size:
            raise ConfigError(
                f"{who}: the observation '{options.feedforward}' has {size} numbers and the action "
                f"{context.action_size}; choose an actuation that takes joint targets."
            )
        self._name = options.feedforward
        self.feedback = MLPPolicy(options.feedback, context)

    def distribution(self, observations: Mapping[str, Tensor]) -> DiagonalGaussian:
        offset = self.feedback.distribution(observations)
        assert isinstance(offset, DiagonalGaussian)  # joint targets are one box
        if self._name is None:
            return offset
        return DiagonalGaussian(observations[self._name] + offset.mean, offset.std)

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        return self.feedback.value(observations)

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        return self.feedback.actor_parameters()

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        return self.feedback.critic_parameters()

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        self.feedback.observe(observations)

    def schedule(self, samples: int) -> None:
        self.feedback.schedule(samples)
