"""A policy of two plain MLPs: observation to action mean, and to value."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Literal

import torch
from torch import Tensor, nn

from understudy.errors import ConfigError, suggestion
from understudy.nn import DiagonalGaussian, RunningNormaliser, Schedule, mlp
from understudy.options import check_range
from understudy.task import Context, Policy

ACTIVATIONS: dict[str, type[nn.Module]] = {"relu": nn.ReLU, "elu": nn.ELU, "tanh": nn.Tanh}


def observation_size(context: Context, name: str, who: str) -> int:
    """The size of the flat observation `name`; an error names what the task has instead."""
    shape = context.observation_shapes.get(name)
    if shape is None:
        raise ConfigError(
            f"{who} needs the observation '{name}', which no encoder of this task provides. "
            f"Add encoder.{name}={{name: …}}, or choose another policy."
            + suggestion(name, context.observation_shapes)
        )
    if len(shape) != 1:
        raise ConfigError(f"{who} needs a flat observation '{name}', and its shape is {shape}.")
    return shape[0]


class MLPPolicy(Policy):
    """Gaussian with the mean of an MLP and a scheduled, state-independent deviation."""

    @dataclass(frozen=True)
    class Options:
        observation: str = "state"  #: name of the encoder read
        hidden: tuple[int, ...] = (1024, 512)  #: units per layer (thesis, section 3.4.1)
        activation: Literal["relu", "elu", "tanh"] = "relu"
        #: Standard deviation of the action, in its units.
        noise: Schedule = field(default_factory=lambda: Schedule(0.1, 0.05))
        learn_noise: bool = False  #: learn the deviation from ``noise.start`` instead of scheduling
        final_scale: float = 0.01  #: scale of the actor's last layer at the start

        def __post_init__(self) -> None:
            if any(units < 1 for units in self.hidden):
                raise ValueError(f"hidden={self.hidden} is not possible: every layer needs a unit.")
            for end in ("start", "end"):  # checked here: other schedules may reach zero
                if not getattr(self.noise, end) > 0:
                    raise ValueError(
                        f"noise.{end}={getattr(self.noise, end)} is not possible: it must be greater than 0."
                    )
            check_range(self, "final_scale", least=0)

    deviation: Tensor

    def __init__(self, options: Options, context: Context) -> None:
        super().__init__()
        self.options = options
        size = observation_size(context, options.observation, "policy 'mlp'")
        activation = ACTIVATIONS[options.activation]
        self.normaliser = RunningNormaliser(size)
        layers = [size, *options.hidden]
        self.actor = mlp(
            [*layers, context.action_size], activation=activation, final_scale=options.final_scale
        )
        self.critic = mlp([*layers, 1], activation=activation)
        log_deviation = torch.full((context.action_size,), options.noise.start).log()
        self.log_deviation = nn.Parameter(log_deviation, requires_grad=options.learn_noise)

    def distribution(self, observations: Mapping[str, Tensor]) -> DiagonalGaussian:
        mean = self.actor(self.normaliser(observations[self.options.observation]))
        return DiagonalGaussian(mean, self.log_deviation.exp())

    def value(self, observations: Mapping[str, Tensor]) -> Tensor:
        return self.critic(self.normaliser(observations[self.options.observation])).squeeze(-1)

    def actor_parameters(self) -> Iterator[nn.Parameter]:
        yield from self.actor.parameters()
        if self.options.learn_noise:
            yield self.log_deviation

    def critic_parameters(self) -> Iterator[nn.Parameter]:
        return self.critic.parameters()

    def observe(self, observations: Mapping[str, Tensor]) -> None:
        self.normaliser.observe(observations[self.options.observation])

    @torch.no_grad()
    def schedule(self, samples: int) -> None:
        if not self.options.learn_noise:
            self.log_deviation.fill_(self.options.noise.at(samples)).log_()
